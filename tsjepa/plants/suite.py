"""Any task of the dm_control suite as a plant."""

from __future__ import annotations

import copy
import functools
import os
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.plants.mujoco_plant import MujocoPlant
from tsjepa.plants.policies import Rest, load_policy
from tsjepa.plants.streams import START
from tsjepa.support.spec import PlantSpec


class Suite(MujocoPlant):
    """A task of the dm_control suite: its starts, its commands, its reward as the score; it never fails.

    What it loses: a reward sees positions and velocities only (no command, no activation, no history), a camera that
    follows stands still, only geoms are drawn, and a task that draws part of its model anew in every episode, such as a
    target, is refused.

    The state is positions, then velocities. Physics steps are those of the suite or 2 ms, whichever is shorter.

    Args:
        domain, task: as of ``dm_control.suite.load``.
        expert: a policy from states [..., n] to commands [..., m]; a module, or the file of one that ``torch.jit`` or
            ``torch.export`` has saved. None for none: the only policy is then the command at rest.
        frame: height and width of a picture in pixels.
        camera: name or number of one of the task's cameras.
        slot: seconds between commands; the task's own by default.
        process_noise_std: noise on the velocities after every slot.

    Raises:
        ValueError: there is no such task or camera, or its episodes differ in more than positions and velocities.
    """

    def __init__(
        self,
        domain: str,
        task: str,
        expert: nn.Module | str | os.PathLike | None = None,
        frame: tuple[int, int] = (64, 64),
        camera: str | int = 0,
        slot: float | None = None,
        process_noise_std: float = 0.0,
    ) -> None:
        self.init_args = {
            "domain": domain,
            "task": task,
            "expert": expert if expert is None or isinstance(expert, nn.Module) else str(expert),
            "frame": frame,
            "camera": camera,
            "slot": slot,
            "process_noise_std": process_noise_std,
        }
        self.domain, self.task = domain, task
        model = copy.copy(self._environment.physics.model.ptr)
        from tsjepa.plants.auto_camera import named_view
        from tsjepa.plants.joints import POSITIONS, RATES, actuator_names, names_of

        names, units, _ = names_of(model, POSITIONS, RATES)
        commands = self._environment.action_spec()
        spec = PlantSpec(
            action_low=tuple(commands.minimum.tolist()),
            action_high=tuple(commands.maximum.tolist()),
            slot=slot or self._environment.control_timestep(),
            frame=(frame[0], frame[1]),
            state_names=tuple(names),
            state_units=tuple(units),
            action_names=tuple(actuator_names(model)),
        )
        still = np.zeros(model.nq + model.nv)
        super().__init__(model, spec, named_view(model, camera), still, process_noise_std)
        low, high = spec.action_low, spec.action_high
        self.expert = Rest(spec.rest) if expert is None else load_policy(expert, low, high)

    def __getstate__(self) -> dict:
        return {name: value for name, value in super().__getstate__().items() if name != "_environment"}

    @functools.cached_property
    def _environment(self):
        from dm_control import suite

        if (self.domain, self.task) not in suite.ALL_TASKS:
            tasks = [task for domain, task in suite.ALL_TASKS if domain == self.domain]
            known = (
                f"{self.domain} has {', '.join(tasks)}"
                if tasks
                else f"the domains are {', '.join(suite.TASKS_BY_DOMAIN)}"
            )
            raise ValueError(f"The suite has no task {self.domain!r}, {self.task!r}; {known}.")
        environment = suite.load(self.domain, self.task, {"random": 0})
        drawn = [_model_bytes(environment, seed) for seed in (1, 2)]
        if drawn[0] != drawn[1]:
            raise ValueError(
                f"The task {self.domain}, {self.task} draws part of its model (a target, say) anew in every episode; "
                "no state of a plant can hold that: write a plant in which it is the reference."
            )
        return environment

    def start(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """What the task draws."""
        task, physics = self._environment.task, self._environment.physics
        rows = np.zeros((len(device), self.model.nq + self.model.nv + self.model.na))
        for row, (one, number) in enumerate(zip(device, episode, strict=True)):
            key = [seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF, int(one), int(number), START]
            task.random.set_state(np.random.RandomState(key).get_state())
            with physics.reset_context():
                task.initialize_episode(physics)
            rows[row] = np.concatenate([physics.data.qpos, physics.data.qvel, physics.data.act])
        return rows

    def state(self, physics: np.ndarray) -> np.ndarray:
        """Positions and velocities."""
        return physics[:, : self.model.nq + self.model.nv]

    def score(self, state, reference=None):
        """The task's reward in each state."""
        return _rowwise(self._reward, state)

    def _reward(self, state: np.ndarray) -> float:
        physics = self._environment.physics
        with physics.reset_context():
            physics.data.qpos[:], physics.data.qvel[:] = state[: self.model.nq], state[self.model.nq :]
        return float(np.clip(self._environment.task.get_reward(physics), 0.0, 1.0))

    def linear(self) -> None:
        """None: the goal is the task's own."""
        return None

    def experts(self) -> dict[str, nn.Module]:
        """The one that was given."""
        return {"expert": self.expert}


def _rowwise(function: Callable[[np.ndarray], float], state):
    """[...] of states [..., n], as an array or a tensor as they are."""
    rows = np.asarray(state, np.float64).reshape(-1, state.shape[-1])
    values = np.array([function(row) for row in rows], np.float64).reshape(state.shape[:-1])
    return torch.from_numpy(values) if isinstance(state, Tensor) else values


def _model_bytes(environment, seed: int) -> bytes:
    """The model as it is in an episode with this seed."""
    import mujoco

    environment.task.random.set_state(np.random.RandomState(seed).get_state())
    with environment.physics.reset_context():
        environment.task.initialize_episode(environment.physics)
    model = environment.physics.model.ptr
    buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()
