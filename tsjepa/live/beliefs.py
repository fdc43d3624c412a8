"""What the controller believes about every device, and which commands it has sent; all devices at once."""

from __future__ import annotations

import numpy as np

from tsjepa.live.graphs import Graphs
from tsjepa.live.timing import Durations

HORIZON = 64  # slots for which a device is predicted, and by which an update can be late
NEVER = -1


class Beliefs:
    """Embeddings of I devices, each of the slot for which its last command was.

    A device's command is for the slot that it will be in when the command arrives. That is the slot of its update plus
    the round trip that it reports, so that no clocks have to agree. An update that is older than its command is
    predicted up to there, through the commands that were sent meanwhile.

    Args:
        graphs: with the parts "receive" and, where the model predicts, "predict".
        devices: I.
        buffer: N, commands in a plan.
    """

    def __init__(self, graphs: Graphs, devices: int, buffer: int = 1) -> None:
        self.graphs, self.buffer = graphs, buffer
        self.newest = np.full(devices, NEVER)  # slot of the newest update
        self.told = np.full(devices, NEVER)  # slot of the newest command
        self.round_trip = np.zeros(devices, np.int64)
        embedding, _ = graphs.receive(np.zeros((1, graphs.payload_bytes), np.uint8))
        self.embedding = np.zeros((devices, embedding.shape[1]), np.float32)
        self.commands = np.tile(graphs.rest, (devices, HORIZON, 1)).astype(np.float32)  # by slot, modulo the horizon
        self.plan = np.tile(graphs.rest, (devices, buffer, 1)).astype(np.float32)  # the newest that was sent
        self.begun = np.full(devices, NEVER)  # its slot
        self.stages = {"act": Durations(), "predict": Durations()}

    def forget(self, device: int) -> None:
        """A device has started anew and counts its slots from 0."""
        self.newest[device] = self.told[device] = self.begun[device] = NEVER
        self.round_trip[device] = 0
        self.commands[device] = self.plan[device] = self.graphs.rest

    def update(
        self, device: np.ndarray, slot: np.ndarray, round_trip: np.ndarray, payload: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Takes updates, no device twice and each newer than the one before.

        Args:
            device: numbers int64 [n].
            slot, round_trip: int64 [n].
            payload: uint8 [n, bytes].

        Returns:
            The slots that the commands are for, int64 [n], and plans float32 [n, N, m].
        """
        with self.stages["act"].timed():
            embedding, command = (part.copy() for part in self.graphs.receive(payload))
        target = np.maximum(slot + np.minimum(round_trip, HORIZON - 1), self.told[device])
        self._hold_until(device, target)
        behind = target - slot if self.graphs.has_predictor else np.zeros_like(slot)
        for late in range(int(behind.max(initial=0))):
            rows = np.flatnonzero(behind > late)
            given = self.commands[device[rows], (slot[rows] + late) % HORIZON]
            embedding[rows], command[rows] = self._predict(embedding[rows], given)
        self.newest[device], self.round_trip[device] = slot, round_trip
        return self._tell(device, target, embedding, command)

    def predict(self, device: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The next slot of devices from which nothing has come for it; returns as :meth:`update` does."""
        told = self.told[device]
        embedding, command = self._predict(self.embedding[device], self.commands[device, told % HORIZON])
        return self._tell(device, told + 1, embedding, command)

    def predictable(self) -> np.ndarray:
        """Which devices have been heard of within the horizon, bool [I]."""
        return (self.newest != NEVER) & (self.told - self.newest < HORIZON - 1) & self.graphs.has_predictor

    def age(self, device: np.ndarray) -> np.ndarray:
        """Slots from the newest update to the newest command, 1 for an update of the command's own slot."""
        return self.told[device] - self.newest[device] + 1

    def _hold_until(self, device: np.ndarray, target: np.ndarray) -> None:
        """What the actuator has done in the slots before ``target`` for which no command was sent."""
        for number, last, until in zip(device, self.told[device], target, strict=True):
            for gap in range(max(last + 1, until - HORIZON + 1), until):
                self.commands[number, gap % HORIZON] = self._in_force(number, gap)

    def _in_force(self, device: np.ndarray, slot: np.ndarray) -> np.ndarray:
        """What actuators do [n, m] in slots from the newest plan's on: they play it and hold its last command."""
        return self.plan[device, np.minimum(slot - self.begun[device], self.buffer - 1)]

    def _tell(
        self, device: np.ndarray, target: np.ndarray, embedding: np.ndarray, command: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        command = np.clip(command, self.graphs.low, self.graphs.high)
        self.told[device], self.embedding[device] = target, embedding
        plan = [command]
        for _ in range(1, self.buffer):
            embedding, command = self._predict(embedding, plan[-1])
            plan.append(np.clip(command, self.graphs.low, self.graphs.high))
        plans = np.stack(plan, axis=1)
        sent = np.isfinite(plans).all((1, 2))  # a plan with NaN stays here; the actuator goes on with the one before
        self.plan[device[sent]], self.begun[device[sent]] = plans[sent], target[sent]
        self.commands[device, target % HORIZON] = self._in_force(device, target)
        return target, plans

    def _predict(self, embedding: np.ndarray, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with self.stages["predict"].timed():
            return self.graphs.predict(embedding, command)
