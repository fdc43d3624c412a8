"""What the actuator has been told: the commands of the newest packet for each slot, and how long ago it came."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

KEPT = 16  # packets, most of them for slots to come
MEASURED = 16  # round trips


class _Plan(NamedTuple):
    slot: int
    sequence: int
    commands: np.ndarray


class Plans:
    """Chooses the command of a slot as the chain's actuator does: that of the newest packet, whose last one is held.

    Of packets for the same slot the one that was sent later counts; packets for a slot to come wait for it. ``begun``
    is the slot of the packet that :meth:`at` has chosen last.
    """

    def __init__(self) -> None:
        self._plans: list[_Plan] = []
        self.begun = -1
        self._round_trips: list[int] = []

    def clear(self) -> None:
        """Forgets all commands."""
        self._plans = []

    def put(self, slot: int, sequence: int, commands: np.ndarray) -> None:
        """Keeps the commands [N, m] for ``slot`` and the slots after it."""
        self._plans = sorted([*self._plans, _Plan(slot, sequence, commands)], key=lambda plan: plan[:2])[-KEPT:]

    def at(self, slot: int) -> np.ndarray | None:
        """The command [m] of a slot; None where none has come for it or for a slot before it.

        Forgets what an earlier slot would need, so slots are asked for in their order.
        """
        begun = [plan for plan in self._plans if plan.slot <= slot]
        if not begun:
            return None
        newest = begun[-1]
        self.begun = newest.slot
        self._plans = [newest, *(plan for plan in self._plans if plan.slot > slot)]
        return newest.commands[min(slot - newest.slot, len(newest.commands) - 1)]

    def measure(self, slots: int) -> None:
        """Notes the slots from an update to the arrival of its prompt answer."""
        self._round_trips = [*self._round_trips, min(max(slots, 0), 255)][-MEASURED:]

    @property
    def round_trip(self) -> int:
        """Slots after which nearly every answer has come: more only for two of the last 16."""
        ordered = sorted(self._round_trips)
        return ordered[max(len(ordered) - 3, 0)] if ordered else 0
