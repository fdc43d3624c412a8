"""Devices and a controller over real sockets in virtual time, and graphs that are plain arithmetic."""

import heapq
import itertools
from types import SimpleNamespace

import numpy as np

from tsjepa.live import controller_loop, device_loop, timing
from tsjepa.live.controller_loop import Controller
from tsjepa.live.device_loop import Device
from tsjepa.live.port import Port
from tsjepa.live.seal import Seal

TICKS = 8  # of the controller in a slot


class Graphs:
    """A payload of two bytes is an embedding of two numbers; a slot adds the command to the first, 1 to the second.

    The command is minus a tenth of the first number; ``spoil`` replaces it.
    """

    slot, payload_bytes, belief_dim, has_predictor = 0.02, 2, 0, True
    low, high, rest = np.float32([-20]), np.float32([20]), np.float32([0])
    spoil = None

    def encode(self, frames):
        return frames.astype(np.uint8)

    def receive(self, payload):
        embedding = payload.astype(np.float32)
        return embedding, self._act(embedding)

    def predict(self, embedding, command):
        following = embedding + np.concatenate([command, np.ones_like(command)], 1)
        return following, self._act(following)

    def _act(self, embedding):
        command = -0.1 * embedding[:, :1]
        return command if self.spoil is None else np.full_like(command, self.spoil)


class Machine:
    """Shows its number of slots, twice; remembers the commands that were applied."""

    at_once, place = False, None

    def __init__(self, devices: int = 1) -> None:
        self.devices, self.applied = devices, []

    def look(self):
        return np.full((self.devices, 2), len(self.applied) % 256)

    def act(self, commands):
        self.applied.append(commands[:, 0].copy())
        return False

    def summary(self):
        return {}


class World:
    """Runs a controller and devices slot by slot; nothing in it waits.

    Args:
        monkeypatch: pytest's, by which the loops read this clock.
    """

    def __init__(self, monkeypatch) -> None:
        self.now, self._number, self._travelling = 1000.0, itertools.count(), []
        clock = SimpleNamespace(monotonic=lambda: self.now, perf_counter=lambda: self.now)
        for module in (controller_loop, device_loop, timing):
            monkeypatch.setattr(module, "time", clock)
        monkeypatch.setattr(Port, "send_later", lambda port, *packet: self._post(port, *packet))
        self.controller, self.devices, self.slot = None, [], 0

    def control(self, devices: int = 1, graphs=None, seal: Seal | None = None, port: int = 0, **options) -> Controller:
        """Starts a controller, at the ``port`` of one that has ended where it is to take its place."""
        graphs = graphs or Graphs()
        self.controller = Controller(graphs, devices, ("127.0.0.1", port), seal or Seal(), **options)
        return self.controller

    def device(self, machine=None, numbers=(0,), graphs=None, seal: Seal | None = None, **options) -> Device:
        """Starts a process of devices, which begins in the world's next slot."""
        machine = machine or Machine(len(numbers))
        address = self.controller.port.address[:2]
        made = Device(graphs or Graphs(), machine, list(numbers), address, seal or Seal(), **options)
        for link in made.links.values():
            made.port.send(made.seal.close(link.header(device_loop.HELLO)))
        self.controller.port.drain()
        made.port.drain()
        made.metronome.started = self.now
        self.devices.append((made, self.slot))
        return made

    def run(self, slots: int, hostile=None) -> None:
        """Lets time pass; ``hostile`` is called with the controller's address before each of its ticks."""
        for _ in range(slots):
            start = self.now
            for device, first in self.devices:
                device.begin_slot()
                assert device.slot == self.slot - first
            for tick in range(TICKS):
                self.now = start + 0.02 * (tick + 0.5) / TICKS
                self._deliver()
                if hostile is not None:
                    hostile(self.controller.port.address)
                if self.controller.port.socket.fileno() >= 0:
                    self.controller.port.drain()
                    self.controller.predict()
                for device, _ in self.devices:
                    device.port.drain()
            self.slot += 1
            self.now = start + 0.02
            for device, first in self.devices:
                device.tick(self.slot - first)

    def close(self) -> None:
        """Lets the sockets go."""
        for port in (self.controller.port, *(device.port for device, _ in self.devices)):
            port.socket.close()

    def _post(self, port, seconds, data, address=None) -> None:
        heapq.heappush(self._travelling, (self.now + seconds, next(self._number), port, data, address))

    def _deliver(self) -> None:
        while self._travelling and self._travelling[0][0] <= self.now:
            _, _, port, data, address = heapq.heappop(self._travelling)
            if port.socket.fileno() >= 0:
                port.send(data, address)
