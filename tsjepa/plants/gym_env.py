"""Any Gymnasium environment that renders, as a plant."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from torch import Tensor, nn

from tsjepa.plants.mujoco_plant import check_action
from tsjepa.plants.plant import Plant
from tsjepa.plants.policies import Rest, load_policy
from tsjepa.plants.streams import START, uniforms
from tsjepa.support.spec import PlantSpec


class Gym(Plant):
    """A Gymnasium environment with a continuous command: its observation is the state, its reward the score.

    What it loses: its simulator keeps its own state, so that a machine can only go on from where it is (no branch of a
    tensordict, no "exact" controller, no process noise), every slot is rendered whether it is sent or not, and the
    pictures themselves travel as the scene.

    The state is the observation, then the score and 1 where the environment has terminated; from there on it stands
    still and has failed.

    Args:
        env_id: as of ``gymnasium.make``.
        expert: a policy from observations to commands, see :func:`tsjepa.plants.policies.load_policy`; None for none.
        slot: seconds between commands; what the environment says of its frames by default.
        frame: height and width to which its picture is scaled, in pixels.
        reward: lowest and highest reward, which become the scores 0 and 1.
        arguments: more of ``gymnasium.make``.

    Raises:
        ModuleNotFoundError: gymnasium is not installed.
        ValueError: the environment does not render, has no continuous command with limits, observes more than one
            array, or does not tell its slot; or ``reward`` is no range.
    """

    def __init__(
        self,
        env_id: str,
        expert: nn.Module | str | os.PathLike | None = None,
        slot: float | None = None,
        frame: tuple[int, int] = (64, 64),
        reward: tuple[float, float] = (0.0, 1.0),
        arguments: dict[str, Any] | None = None,
    ) -> None:
        kept = expert if expert is None or isinstance(expert, nn.Module) else str(expert)
        self.init_args = {"env_id": env_id, "expert": kept, "slot": slot, "frame": tuple(frame)}
        self.init_args |= {"reward": tuple(reward), "arguments": arguments}
        self.env_id, self.arguments, self.reward = env_id, dict(arguments or {}), tuple(reward)
        if not self.reward[0] < self.reward[1]:
            raise ValueError(f"reward is {list(self.reward)}; give the lowest and a higher one, which score 0 and 1.")
        env = self._make()
        low, high = getattr(env.action_space, "low", None), getattr(env.action_space, "high", None)
        if low is None or high is None or not np.isfinite([low, high]).all():
            raise ValueError(f"{env_id} has the commands {env.action_space}; a plant needs numbers with limits.")
        if not env.observation_space.shape:
            raise ValueError(
                f"{env_id} has the observations {env.observation_space}; a plant needs one array of numbers: wrap it "
                "in gymnasium.wrappers.FlattenObservation and register that."
            )
        fps = env.metadata.get("render_fps")
        if not (slot or fps):
            raise ValueError(f"{env_id} does not say how long a step is; give slot, in seconds.")
        self.command_shape = low.shape
        count = int(np.prod(env.observation_space.shape))
        self.spec = PlantSpec(
            action_low=tuple(low.ravel().tolist()),
            action_high=tuple(high.ravel().tolist()),
            slot=slot or 1.0 / fps,
            frame=(frame[0], frame[1]),
            state_names=(*(f"observation_{index}" for index in range(count)), "score", "terminated"),
        )
        bounds = self.spec.action_low, self.spec.action_high
        self.expert = Rest(self.spec.rest) if expert is None else _OnObservation(load_policy(expert, *bounds))
        self._running: dict[tuple[int, int], Any] = {}  # by seed and device, with the state that each is in
        self._last: dict[tuple[int, int], np.ndarray] = {}
        env.close()

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_running": {}, "_last": {}}

    def _make(self):
        try:
            import gymnasium
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError("A Gym plant needs gymnasium: pip install 'tsjepa[gym]'.") from error
        try:
            return gymnasium.make(self.env_id, render_mode="rgb_array", disable_env_checker=True, **self.arguments)
        except gymnasium.error.Error as error:
            raise ValueError(f"{self.env_id} cannot be made: {error}") from error

    def start(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """Its own starts, seeded by device and episode."""
        rows = []
        for one, number in zip(device.tolist(), episode.tolist(), strict=True):
            env = self._running.get((seed, one)) or self._make()
            draw = uniforms(seed, START, np.array([one]), np.array([number]), count=1)
            observation, _ = env.reset(seed=int(draw[0, 0] * 2**31))
            self._running[seed, one] = env
            self._last[seed, one] = np.concatenate([np.ravel(observation), [0.0, 0.0]]).astype(np.float64)
            rows.append(self._last[seed, one])
        return np.stack(rows) if rows else np.empty((0, self.spec.state_dim))

    def advance(self, physics, action, seed, device, episode, slot) -> np.ndarray:
        """One step of each environment.

        Raises:
            ValueError: a command out of range, or a machine that is asked to go on from where it is not.
        """
        check_action(action, self.spec)
        rows = np.array(physics)
        low, high = self.reward
        for row, one in enumerate(device.tolist()):
            env = self._at(seed, one, rows[row])
            if not rows[row, -1]:
                command = np.asarray(action[row], np.float32).reshape(self.command_shape)
                observation, reward, terminated, _, _ = env.step(command)
                score = np.clip((reward - low) / (high - low), 0.0, 1.0)
                rows[row] = np.concatenate([np.ravel(observation), [score, terminated]])
                self._last[seed, one] = rows[row].copy()
        return rows

    def _at(self, seed: int, device: int, physics: np.ndarray):
        last = self._last.get((seed, device))
        if last is None or not np.array_equal(last, physics):
            raise ValueError(
                f"{self.env_id} keeps its own state: a machine can only go on from where it is; start a new episode."
            )
        return self._running[seed, device]

    def state(self, physics: np.ndarray) -> np.ndarray:
        """Observation, score, whether it has terminated."""
        return physics

    def scene(self, physics, seed, device, episode) -> np.ndarray:
        """The picture itself, [N, H * W * 3]."""
        import cv2

        height, width = self.spec.frame
        pictures = []
        for row, one in enumerate(device.tolist()):
            picture = self._at(seed, one, physics[row]).render()
            pictures.append(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA).ravel())
        return np.array(pictures, np.float32).reshape(len(device), height * width * 3)

    def render(self, scene: np.ndarray) -> np.ndarray:
        """Pictures uint8 [N, H, W, 3]."""
        return scene.astype(np.uint8).reshape(len(scene), *self.spec.frame, 3)

    def camera(self) -> dict:
        """What made the pictures."""
        return {"environment": self.env_id, "height": self.spec.frame[0], "width": self.spec.frame[1]}

    def score(self, state, reference=None):
        """The reward, scaled."""
        return state[..., -2]

    def failed(self, state):
        """The environment has terminated."""
        return state[..., -1] > 0.5

    def experts(self) -> dict[str, nn.Module]:
        """The one that was given."""
        return {"expert": self.expert}


class _OnObservation(nn.Module):
    """A policy that is not shown the score and the end."""

    def __init__(self, policy: nn.Module) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        return self.policy(state[..., :-2])
