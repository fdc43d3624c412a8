"""The loop of a controller: it keeps beliefs about many devices and sends every one its commands."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any, BinaryIO

import numpy as np

from tsjepa.live.beliefs import Beliefs
from tsjepa.live.graphs import Graphs
from tsjepa.live.link import Link
from tsjepa.live.notices import tell
from tsjepa.live.packet import COMMAND, UPDATE, Command, Dropped, Header, read_update
from tsjepa.live.port import Address, Port
from tsjepa.live.recorded import Record
from tsjepa.live.seal import Seal
from tsjepa.live.timing import Ages, Durations

STAGES = ("receive", "send", "receive to command")
TICKS = 8  # in a slot, at which commands that are due are sent
PATIENCE = 0.25  # of a slot, for which an update is waited for before its device is predicted
EARLIEST_OF = 32  # updates, or twice as many, tell when an update is due: a network that slows down is followed
LAST_SLOT = 2**31 - 1024  # of an update: the commands for the slots after it still have a number in a header
HELLO_S = 0.01  # between two hellos to one device


class Controller:
    """Answers every update at once, and predicts devices whose update has not come when their command is due.

    Args:
        graphs: with the parts "receive" and "predict".
        devices: I; devices 0 to I - 1 are known.
        bind: host and port.
        seal: of the datagrams.
        weather: of the commands, or None.
        buffer: N, commands in a packet.
        realtime_factor: how fast time passes, as at the devices.

    Attributes:
        log: an unbuffered file, is written a line "seconds,device,slot" for every update that is used; None for no log.
        record: takes the age behind every command, in the slot that it is for; None for nobody.
    """

    log: BinaryIO | None = None
    record: Record | None = None

    def __init__(
        self,
        graphs: Graphs,
        devices: int,
        bind: tuple[str, int],
        seal: Seal,
        weather: Any = None,
        buffer: int = 1,
        realtime_factor: float = 1.0,
    ) -> None:
        self.graphs, self.seal, self.weather = graphs, seal, weather
        self.beliefs = Beliefs(graphs, devices, buffer)
        self.links = [Link(number) for number in range(devices)]
        self.addresses: list[Address | None] = [None] * devices
        self.sessions = [0] * devices
        self.greeted = [-math.inf] * devices
        self.slot_s, self.realtime_factor = graphs.slot / realtime_factor, realtime_factor
        # when an update of slot 0 would have come, by this clock: by the newest updates, and by those before
        self.begins, self.began = np.full((2, devices), np.inf)
        self.measured = np.zeros(devices, np.int64)  # updates of which ``begins`` is the earliest
        self.stages = {name: Durations() for name in STAGES} | self.beliefs.stages
        self.ages, self.waiting = Ages(), {}
        self.counts = dict.fromkeys(("updates", "commands", "predictions", "refused", "lost"), 0)
        self.started = time.monotonic()
        self.port = Port(self.hear, bind=bind, after=self.answer)

    async def run(self, seconds: float, stop: asyncio.Event) -> None:
        """Works until ``stop``, or as many seconds."""
        self.port.open()
        self.started = time.monotonic()
        loop, tick = asyncio.get_running_loop(), self.slot_s / TICKS
        try:
            end = self.started + seconds / self.realtime_factor
            following = loop.time()
            while not stop.is_set() and time.monotonic() < end:
                self.predict()
                following = max(following + tick, loop.time())
                await asyncio.sleep(following - loop.time())
        finally:
            self.port.close()

    def hear(self, data: bytes, address: Address) -> None:
        """Takes a datagram of a device's; an update waits for :meth:`answer`.

        Raises:
            Dropped: it is not used.
        """
        arrived = time.monotonic()
        with self.stages["receive"].timed():
            header, body = self.seal.open(data)
            if header.device >= len(self.links) or header.kind == COMMAND:
                raise Dropped("device" if header.device >= len(self.links) else "kind")
            update = read_update(body, self.graphs.payload_bytes) if header.kind == UPDATE else None
            if update is not None and not 0 <= header.slot <= LAST_SLOT:
                raise Dropped("range")
            link = self.links[header.device]
            try:
                link.accept(header)
            except Dropped as drop:
                self.greet(header, address, drop)
                raise
            if update is None:
                return
            self.note(header, address, arrived)
            self.port.drops["overtaken"] += header.device in self.waiting
            self.waiting[header.device] = header.slot, update, arrived

    def greet(self, header: Header, address: Address, drop: Dropped) -> None:
        """Tells a device of which nothing else can be used this end's session, unless it was a replay."""
        now = time.monotonic()
        if drop.args[0] != "replayed" and now - self.greeted[header.device] >= HELLO_S:
            self.greeted[header.device] = now
            self.port.send(self.seal.close(self.links[header.device].hello(header)), address)

    def note(self, header: Header, address: Address, arrived: float) -> None:
        """Where a device is and what time it is there.

        Raises:
            Dropped: "overtaken", of an update that is not the newest.
        """
        device = header.device
        if header.session != self.sessions[device]:
            self.beliefs.forget(device)
            self.sessions[device] = header.session
            self.begins[device] = self.began[device] = np.inf
            self.waiting.pop(device, None)
        newest = self.waiting[device][0] if device in self.waiting else self.beliefs.newest[device]
        if header.slot <= newest:
            raise Dropped("overtaken")
        self.addresses[device] = address
        if self.measured[device] == EARLIEST_OF:
            self.began[device], self.begins[device], self.measured[device] = self.begins[device], np.inf, 0
        self.begins[device] = min(self.begins[device], arrived - header.slot * self.slot_s)
        self.measured[device] += 1

    def answer(self) -> None:
        """Commands for the updates that are waiting."""
        if not self.waiting:
            return
        waiting, self.waiting = self.waiting, {}
        device = np.fromiter(waiting, np.int64)
        slot = np.array([slot for slot, _, _ in waiting.values()])
        round_trip = np.array([update.round_trip for _, update, _ in waiting.values()])
        payload = np.frombuffer(b"".join(update.payload for _, update, _ in waiting.values()), np.uint8)
        target, plans = self.beliefs.update(device, slot, round_trip, payload.reshape(len(device), -1))
        self.ages.add(self.beliefs.age(device))
        self.counts["updates"] += len(device)
        for row, (number, (_, _, arrived)) in enumerate(waiting.items()):
            self.send(number, target[row], plans[row], prompt=True)
            self.stages["receive to command"].add(time.monotonic() - arrived)
        if self.log is not None:
            self.write_log(self.log, device, slot)

    def write_log(self, log: BinaryIO, device: np.ndarray, slot: np.ndarray) -> None:
        """Logs the updates of devices; a disk that is full ends the log and not the loop."""
        passed = time.monotonic() - self.started
        try:
            log.write("".join(f"{passed:.6f},{n},{s}\n" for n, s in zip(device, slot, strict=True)).encode())
        except OSError as error:
            self.log = None
            tell("controller", f"the log ends here, it cannot be written ({error.strerror}); the loop goes on.")

    def predict(self) -> None:
        """Commands for the devices whose next slot has come without an update."""
        beliefs = self.beliefs
        late = time.monotonic() - np.minimum(self.begins, self.began) - PATIENCE * self.slot_s
        due = late >= (beliefs.told + 1 - beliefs.round_trip) * self.slot_s
        device = np.flatnonzero(due & beliefs.predictable())
        if not len(device):
            return
        target, plans = beliefs.predict(device)
        self.ages.add(beliefs.age(device))
        self.counts["predictions"] += len(device)
        for row, number in enumerate(device):
            self.send(int(number), target[row], plans[row], prompt=False)

    def send(self, number: int, slot: int, plan: np.ndarray, prompt: bool) -> None:
        """Sends a plan, as the weather lets it; one with a number that the actuator does not take stays here."""
        if not ((plan >= self.graphs.low) & (plan <= self.graphs.high)).all():
            if not self.counts["refused"]:
                tell("controller", f"the model's command for device {number} is no finite number and is not sent.")
            self.counts["refused"] += 1
            return
        with self.stages["send"].timed():
            command = Command(int(self.beliefs.newest[number]), prompt, plan)
            data = self.seal.close(self.links[number].header(COMMAND, int(slot)), command.pack())
            delay = 0.0
            if self.weather is not None:
                delay = self.weather.delay(number, 0, int(slot)) / self.realtime_factor
            self.counts["commands"] += 1
            if self.record is not None:
                self.record(number, int(slot), {}, {"age": self.beliefs.age(np.array([number]))})
            if delay == math.inf:
                self.counts["lost"] += 1
            elif delay:
                self.port.send_later(delay, data, self.addresses[number])
            else:
                self.port.send(data, self.addresses[number])

    def summary(self) -> dict:
        """What happened, as plain values."""
        return {
            "seconds": time.monotonic() - self.started,
            "devices_heard": int((self.beliefs.newest >= 0).sum()),
            "datagrams": self.port.received,
            "counts": self.counts,
            "dropped": dict(self.port.drops),
            "age_slots": self.ages.summary(),
            "stages": {name: stage.summary() for name, stage in self.stages.items()},
        }
