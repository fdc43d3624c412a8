"""The cart-pole's equations of motion, for one plant or many, without dm_control."""

from __future__ import annotations

import math
import os
from pathlib import Path

import mujoco
import numpy as np
from mujoco.rollout import Rollout

MODEL_PATH = Path(__file__).with_name("cartpole.xml")
MAX_TIMESTEP = 0.002
FORCE_LIMIT = 20.0
THREADS = min(4, os.cpu_count() or 1)
FULL_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


def substeps(sampling_interval: float) -> tuple[int, float]:
    """Split a slot into the fewest equal physics steps of at most 2 ms.

    Args:
        sampling_interval: slot length in seconds.

    Returns:
        Number of physics steps and the length of each in seconds.

    Raises:
        ValueError: if the interval is not a positive finite number of seconds.
    """
    if not (math.isfinite(sampling_interval) and sampling_interval > 0):
        raise ValueError(f"sampling_interval must be a positive number of seconds, got {sampling_interval!r}.")
    steps = math.ceil(round(sampling_interval / MAX_TIMESTEP, 6))
    return steps, sampling_interval / steps


def load_model(sampling_interval: float = 0.02) -> mujoco.MjModel:
    """Load the cart-pole with the physics timestep that fits `sampling_interval` (seconds)."""
    model = mujoco.MjModel.from_xml_path(str(MODEL_PATH))
    model.opt.timestep = substeps(sampling_interval)[1]
    return model


def check_force(force: np.ndarray) -> None:
    """Raise ValueError, naming the value, if a force (newtons) is not a number in [-20, 20]."""
    bad = ~(np.abs(force) <= FORCE_LIMIT)
    if bad.any():
        raise ValueError(f"A force must lie in [-20, 20] N, got {force[bad][0]}; clip the command before the plant.")


class Dynamics:
    """Advances many independent cart-poles by one slot each, with the force held.

    The result for a row depends on nothing but that row's state and force.

    Args:
        sampling_interval: slot length in seconds, stepped at 2 ms or less.
    """

    def __init__(self, sampling_interval: float = 0.02) -> None:
        self.sampling_interval = sampling_interval
        self.steps, _ = substeps(sampling_interval)
        self.model = load_model(sampling_interval)
        self._workers = [mujoco.MjData(self.model) for _ in range(THREADS)]
        self._rollout = Rollout(nthread=THREADS)
        self._state_size = mujoco.mj_stateSize(self.model, FULL_STATE)

    def __reduce__(self):
        return Dynamics, (self.sampling_interval,)

    def advance(self, state: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Advance float64 states [N, 4] (x, theta, x_dot, theta_dot) under forces [N] in newtons; returns [N, 4]."""
        count = len(state)
        start = np.zeros((count, self._state_size))
        start[:, 1:] = state
        control = np.repeat(np.asarray(force, np.float64).reshape(count, 1, 1), self.steps, axis=1)
        path = np.empty((count, self.steps, self._state_size))
        self._rollout.rollout(
            [self.model] * count, self._workers, start, control, nstep=self.steps, state=path, skip_checks=True
        )
        return path[:, -1, 1:].copy()
