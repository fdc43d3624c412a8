"""The loop of a device: it watches a machine, sends embeddings, and applies the commands that come back."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

import numpy as np

from tsjepa.live.graphs import Graphs
from tsjepa.live.link import Link
from tsjepa.live.packet import COMMAND, HELLO, UPDATE, Dropped, Update, read_command
from tsjepa.live.plans import Plans
from tsjepa.live.port import Address, Port, address_text
from tsjepa.live.recorded import Record
from tsjepa.live.seal import Seal
from tsjepa.live.silence import SILENCE_S, Silence
from tsjepa.live.timing import Durations, Metronome

STAGES = ("capture", "encode", "send", "receive", "apply")
KNOCK_S = 0.1  # between hellos to a controller that has not answered yet


class Device:
    """n devices of one process, which share a machine, a clock and a socket.

    Args:
        graphs: with the part "device".
        machine: a :class:`tsjepa.live.simulated.SimulatedPlants` or a :class:`tsjepa.live.camera.Camera`.
        numbers: of the devices.
        controller: its host and port.
        seal: of the datagrams.
        weather: of the updates, or None.
        period: slots between updates.
        watchdog_s: seconds without a command after which the safe command is in force.
        safe: that command [m]; None for the one nearest to zero.
        realtime_factor: how fast time passes; at 0.5 all that is said in seconds takes twice as long.
        record: takes what every device saw, did and sent in every slot; None for nobody.
    """

    def __init__(
        self,
        graphs: Graphs,
        machine: Any,
        numbers: list[int],
        controller: tuple[str, int],
        seal: Seal,
        weather: Any = None,
        period: int = 1,
        watchdog_s: float = 0.2,
        safe: np.ndarray | None = None,
        realtime_factor: float = 1.0,
        record: Record | None = None,
    ) -> None:
        self.graphs, self.machine, self.seal, self.weather, self.period = graphs, machine, seal, weather, period
        self.links = {number: Link(number) for number in numbers}
        self.plans = {number: Plans() for number in numbers}
        self.heard_at = dict.fromkeys(numbers, -math.inf)
        self.watchdog_s, self.realtime_factor = watchdog_s / realtime_factor, realtime_factor
        self.safe = graphs.rest if safe is None else safe
        self.metronome = Metronome(graphs.slot / realtime_factor)
        self.stages = {name: Durations() for name in STAGES}
        self.slot, self.first = 0, 0  # of all, and of this episode
        self.late = 0
        self.counts = dict.fromkeys(("sent", "lost", "commands", "safe", "held"), 0)
        self.record, self.seen = record, np.empty(0)
        self.remember()
        self.radio = {number: [False, False] for number in numbers}  # sent, and not lost on purpose, in this slot
        self.port = Port(self.hear, connect=controller)
        patience_s = SILENCE_S + period * self.metronome.period
        self.silence = Silence(self.port, address_text(controller), patience_s)

    async def run(self, slots: int | None, stop: asyncio.Event) -> None:
        """Greets the controller, then works ``slots`` slots or until ``stop``; leaves the actuator safe."""
        self.port.open()
        began = time.monotonic()
        try:
            while not stop.is_set() and (waiting := self.strangers()):
                for number in waiting:
                    self.port.send(self.seal.close(self.links[number].header(HELLO)))
                await asyncio.sleep(KNOCK_S)
                self.silence.check(time.monotonic(), dict.fromkeys(self.strangers(), began))
            # one more, in which the last one ends
            async for slot in self.metronome.slots(None if slots is None else slots + 1, stop):
                self.tick(slot)
                if slot != slots:
                    self.begin_slot()
        finally:
            if self.machine.at_once:
                self.machine.act(np.repeat(self.safe[None], len(self.links), 0))
            self.port.close()

    def strangers(self) -> list[int]:
        """Numbers of the devices that the controller has not answered yet."""
        return [number for number, link in self.links.items() if not link.peer]

    def tick(self, slot: int) -> None:
        """Hears what has come, and ends the slots before ``slot``."""
        self.port.drain()
        begun = self.metronome.started
        self.silence.check(time.monotonic(), {number: max(at, begun) for number, at in self.heard_at.items()})
        while self.slot < slot:
            self.end_slot()

    def begin_slot(self) -> None:
        """Looks, encodes and sends, where this is a slot of an update; a device that remembers encodes in every one."""
        applied = self.applied  # in the slot before; what is in force in this one has not moved the machine yet
        if self.machine.at_once:
            self.apply()
        with self.stages["capture"].timed():
            frames = self.machine.look()
        self.seen, self.radio = frames, {number: [False, False] for number in self.links}
        updates = (self.slot - self.first) % self.period == 0
        if not updates and not self.belief.size:
            return
        with self.stages["encode"].timed():
            payloads = self.encode(frames, applied)
        for row, number in enumerate(self.links if updates else ()):
            with self.stages["send"].timed():
                self.send(number, payloads[row].tobytes())
        self.late += time.monotonic() > self.metronome.begins(self.slot + 1)

    def remember(self) -> None:
        """Begins an episode: a device that remembers believes what the warm-up has shown, under the command at rest."""
        self.applied = np.repeat(self.graphs.rest[None], len(self.links), 0)
        self.belief = np.zeros((len(self.links), self.graphs.belief_dim), np.float32)  # zeros are no belief yet
        self.believed = self.slot - 1  # the slot of the belief
        for frames in self.machine.earlier() if self.belief.size else ():
            _, self.belief = self.graphs.observe(frames, self.belief, self.applied)

    def encode(self, frames: np.ndarray, applied: np.ndarray) -> np.ndarray:
        """Payloads uint8 [n, bytes]; a device that remembers makes its belief of this slot.

        A belief of longer ago than the slot before is dropped: one command does not say what moved the machine since.

        Args:
            frames: uint8 [n, kappa, H, W, 3].
            applied: [n, m], in the slot before.
        """
        if not self.belief.size:
            return self.graphs.encode(frames)
        belief = self.belief if self.slot - self.believed == 1 else np.zeros_like(self.belief)
        payloads, self.belief = self.graphs.observe(frames, belief, applied)
        self.believed = self.slot
        return payloads

    def send(self, number: int, payload: bytes) -> None:
        """Sends an update, as the weather lets it."""
        update = Update(self.plans[number].round_trip, payload)
        data = self.seal.close(self.links[number].header(UPDATE, self.slot), update.pack())
        delay = 0.0
        if self.weather is not None:
            episode, slot = self.machine.place or (0, self.slot)
            delay = self.weather.delay(number, episode, slot) / self.realtime_factor
        self.counts["sent"] += 1
        self.radio[number] = [True, delay != math.inf]
        if delay == math.inf:
            self.counts["lost"] += 1
        elif delay:
            # a delay counts from the slot's start, as in the chain, where looking and encoding take no time
            self.port.send_later(self.metronome.begins(self.slot) + delay - time.monotonic(), data)
        else:
            self.port.send(data)

    def hear(self, data: bytes, _: Address) -> None:
        """Takes a datagram of the controller's.

        Raises:
            Dropped: it is not used.
        """
        with self.stages["receive"].timed():
            header, body = self.seal.open(data)
            link = self.links.get(header.device)
            if link is None:
                raise Dropped("device")
            command = None
            if header.kind == COMMAND:
                command = read_command(body, self.graphs.low, self.graphs.high)
            elif header.kind != HELLO or body:
                raise Dropped("kind")
            link.accept(header)
            if command is None:
                return
            plans = self.plans[header.device]
            if command.prompt:
                plans.measure(self.slot - command.answers)
            if command.answers < self.first:
                raise Dropped("overtaken")  # by the start of an episode
            self.counts["commands"] += 1
            self.heard_at[header.device] = time.monotonic()
            plans.put(header.slot, header.sequence, command.plan)
        if self.machine.at_once:
            self.apply()

    def in_force(self, number: int) -> np.ndarray | None:
        """The command [m] of a device in this slot; None for the safe one."""
        silent = time.monotonic() - self.heard_at[number] > self.watchdog_s
        return None if silent else self.plans[number].at(self.slot)

    def apply(self) -> bool:
        """Has the machine do what is in force; returns whether a new episode begins."""
        with self.stages["apply"].timed():
            self.applied = self.commands()
            return self.machine.act(self.applied)

    def commands(self) -> np.ndarray:
        """What is in force [n, m]."""
        commands = [self.in_force(number) for number in self.links]
        return np.stack([self.safe if command is None else command for command in commands])

    def end_slot(self) -> None:
        """Ends this slot; a machine that steps once a slot does it now."""
        for number, plans in self.plans.items():
            safe = self.in_force(number) is None
            self.counts["safe"] += safe
            self.counts["held"] += not safe and plans.begun < self.slot
        if self.record is not None:
            self.write_slot(self.record)
        begins = not self.machine.at_once and self.apply()
        self.slot += 1
        if begins:
            self.first = self.slot
            for plans in self.plans.values():
                plans.clear()
            self.remember()

    def write_slot(self, record: Record) -> None:
        """Has this slot recorded: the newest picture, the true state of a simulated plant, command and radio."""
        commands, state = self.commands(), getattr(self.machine, "state", None)
        for row, number in enumerate(self.links):
            numbers = {"command": commands[row], "radio": np.array(self.radio[number])}
            if state is not None:
                numbers["state"] = state[row]
            record(number, self.slot, {"camera": self.seen[row, -1]}, numbers)

    def unheard(self) -> list[int]:
        """Numbers of the devices for which no command has ever come; where some were not even answered, of those."""
        return self.strangers() or [number for number, at in self.heard_at.items() if at == -math.inf]

    def summary(self) -> dict:
        """What happened, as plain values."""
        return {
            "slots": self.slot,
            "missed_deadlines": self.metronome.missed + self.late,
            "missed_share": (self.metronome.missed + self.late) / max(self.slot, 1),
            "updates": {name: self.counts[name] for name in ("sent", "lost")},
            "commands": {"received": self.counts["commands"], **{n: self.counts[n] for n in ("safe", "held")}},
            "devices_without_a_command": self.unheard(),
            "round_trip_slots": max(plans.round_trip for plans in self.plans.values()),
            "dropped": dict(self.port.drops),
            "stages": {name: stage.summary() for name, stage in self.stages.items()},
            "machine": self.machine.summary(),
        }
