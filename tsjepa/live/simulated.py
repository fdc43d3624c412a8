"""Simulated plants in real time: what the camera and the actuator of a device stand for."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from tsjepa.plants import build_plant
from tsjepa.support.checks import at_least
from tsjepa.support.seeds import HELD_OUT

REMEMBERED = 1000  # scores of episodes


class SimulatedPlants:
    """Plants of one kind that step once a slot, under the command that is in force when the slot ends.

    So a command that arrives within its slot is applied to it, as in the chain. Starts and noise are those of
    ``tsjepa evaluate`` and ``tsjepa simulate`` with the same seed, device and frame history.

    Args:
        plant: its description, a ``class_path`` with ``init_args``.
        devices: numbers of the devices [n].
        seed: of starts and noise.
        episode_slots: slots after which every plant begins anew from its next start; None for never.
        frame_history: slots up to slot 0 at rest, which fill the first stack.
        frame_stack, frame_spacing: of the model.

    Raises:
        ValueError: a description of no plant, or a number below 1.
    """

    at_once = False  # a command counts from the slot's start, so nothing happens when it arrives

    def __init__(
        self,
        plant: Mapping[str, Any],
        devices: np.ndarray,
        seed: int,
        episode_slots: int | None,
        frame_history: int,
        frame_stack: int,
        frame_spacing: int,
    ) -> None:
        at_least(1, frame_history=frame_history, **({} if episode_slots is None else {"episode_slots": episode_slots}))
        self.plant = build_plant(plant)
        self.devices, self.seed, self.episode_slots = devices, HELD_OUT + seed, episode_slots
        self.spacing, self.span = frame_spacing, (frame_stack - 1) * frame_spacing + 1
        self.history = max(frame_history, self.span)
        self.frames: deque[np.ndarray] = deque(maxlen=self.history)
        self.scores: deque[float] = deque(maxlen=REMEMBERED)
        self.episodes = self.fallen = 0
        self.begin(0)

    def begin(self, episode: int) -> None:
        """Puts every plant at its start of ``episode``, after the warm-up."""
        self.episode, self.slot = np.full(len(self.devices), episode), 0
        rest = np.array(self.plant.spec.rest)[None].repeat(len(self.devices), 0)
        self.physics = self.plant.start(self.seed, self.devices, self.episode)
        for slot in range(1 - self.history, 0):
            self._picture()
            self._advance(rest, slot)
        self._picture()
        self.down = np.asarray(self.plant.failed(self.state))
        self.total = np.zeros(len(self.devices))

    @property
    def state(self) -> np.ndarray:
        """True states [n, ...], which only scores are made of."""
        return self.plant.state(self.physics)

    @property
    def place(self) -> tuple[int, int]:
        """Episode, and slot within it."""
        return int(self.episode[0]), self.slot

    def look(self) -> np.ndarray:
        """The newest stack of every camera, uint8 [n, frame_stack, H, W, 3], oldest frame first."""
        return self._stack(len(self.frames))

    def earlier(self) -> list[np.ndarray]:
        """The stacks before the newest, the oldest first; at the start of an episode those of the warm-up."""
        return [self._stack(end) for end in range(self.span, len(self.frames))]

    def _stack(self, end: int) -> np.ndarray:
        return np.stack(list(self.frames)[end - self.span : end : self.spacing], axis=1)

    def act(self, commands: np.ndarray) -> bool:
        """Ends a slot: the plants move under ``commands`` [n, m]; returns whether a new episode begins."""
        self._advance(commands.astype(np.float64), self.slot)
        reference = self.plant.references(self.seed, self.devices, self.episode, np.full(len(self.devices), self.slot))
        state = self.state
        self.down |= np.asarray(self.plant.failed(state))
        self.total += np.where(self.down, 0.0, self.plant.score(state, reference))
        self.slot += 1
        ends = self.slot == self.episode_slots
        if ends:
            self._finish()
            self.begin(int(self.episode[0]) + 1)
        else:
            self._picture()
        return ends

    def summary(self) -> dict:
        """Raw scores (share of the slots in the target, none from a fall on) of the last episodes, and all falls."""
        if self.episode_slots is None and self.slot:
            self._finish()
        scores = list(self.scores)
        figures = {"episodes": self.episodes, "fallen": self.fallen, "raw_scores": scores}
        return figures | ({"raw_score": float(np.mean(scores))} if scores else {})

    def _finish(self) -> None:
        self.scores.extend((self.total / self.slot).tolist())
        self.episodes += len(self.devices)
        self.fallen += int(self.down.sum())

    def _advance(self, command: np.ndarray, slot: int) -> None:
        self.physics = self.plant.advance(
            self.physics, command, self.seed, self.devices, self.episode, np.array([slot])
        )

    def _picture(self) -> None:
        scene = self.plant.scene(self.physics, self.seed, self.devices, self.episode)
        self.frames.append(self.plant.render(np.asarray(scene, np.float32)))
