"""Steps many independent copies of one MuJoCo model, on several threads."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from tsjepa.support.processor import cores

MAX_TIMESTEP = 0.002  # seconds
THREADS = min(4, cores())
FULL_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


def substeps(slot: float, longest: float = MAX_TIMESTEP) -> tuple[int, float]:
    """Splits a slot into the fewest equal physics steps of at most ``longest`` seconds.

    Args:
        slot: its length in seconds.
        longest: bound of a step, seconds.

    Returns:
        Number of physics steps and the length of each in seconds.

    Raises:
        ValueError: the slot is not a positive finite number of seconds.
    """
    if not (math.isfinite(slot) and slot > 0):
        raise ValueError(f"sampling_interval must be a positive number of seconds, got {slot!r}.")
    steps = math.ceil(round(slot / longest, 6))
    return steps, slot / steps


class Stepper:
    """Advances many independent copies of a model by one slot each, with the command held.

    The result for a row depends on nothing but that row's state and command.

    Args:
        model: its timestep is set so that whole steps of at most 2 ms (or its own, if shorter) fill the slot.
        slot: length in seconds.
    """

    def __init__(self, model: mujoco.MjModel, slot: float) -> None:
        self.steps, model.opt.timestep = substeps(slot, min(MAX_TIMESTEP, model.opt.timestep))
        self.model = model
        self._workers = [mujoco.MjData(model) for _ in range(THREADS)]
        self._rollout = Rollout(nthread=THREADS)
        self._state_size = mujoco.mj_stateSize(model, FULL_STATE)

    def advance(self, physics: np.ndarray, action: np.ndarray) -> np.ndarray:
        """States [N, p] float64 (positions, velocities, activations) a slot later under commands [N, m]."""
        count = len(physics)
        start = np.zeros((count, self._state_size))
        start[:, 1:] = physics  # the first number is the time
        control = np.repeat(np.asarray(action, np.float64).reshape(count, 1, -1), self.steps, axis=1)
        path = np.empty((count, self.steps, self._state_size))
        self._rollout.rollout(
            [self.model] * count, self._workers, start, control, nstep=self.steps, state=path, skip_checks=True
        )
        return path[:, -1, 1:].copy()
