"""The regulation task: hold the cart at the origin and the pole upright."""

from __future__ import annotations

import numpy as np
import torchrl  # noqa: F401  (before dm_control: see tsjepa.envs)
from dm_control.rl import control
from dm_env import specs

from tsjepa.envs.dynamics import FORCE_LIMIT, check_force
from tsjepa.envs.physics import CartPolePhysics
from tsjepa.envs.starts import StartDistribution, draw_colors, noise_std_pair
from tsjepa.envs.streams import NOISE, normals
from tsjepa.score import has_failed, in_box

# Not "state": TorchRL 0.14 renames that key to "observation" in what it reads, but not in its specs.
STATE_KEY = "plant_state"
DEVICE = np.zeros(1, np.int64)


class Regulation(control.Task):
    """Reward 1 where |x| <= 0.05 m and |theta| <= 0.05 rad; ends at |theta| > 0.8 rad or |x| > 1.8 m.

    One number is drawn from the seed per episode and keys that episode's start, colours and noise, so the n-th episode
    starts alike whatever was done in those before it.

    Args:
        start: distribution of the start.
        process_noise_std: noise added to (x_dot, theta_dot) after every slot, standard deviations in m/s and rad/s.
        random_colors: draw the colours of cart and pole in every episode.
        seed: seed of all draws; None for a fresh one.
    """

    def __init__(
        self,
        start: StartDistribution | None = None,
        process_noise_std: float | tuple[float, float] = 0.0,
        random_colors: bool = False,
        seed: int | None = None,
    ) -> None:
        self.start = start or StartDistribution()
        self.random_colors = random_colors
        self._noise_std = noise_std_pair(process_noise_std)
        # The name under which TorchRL's set_seed replaces the generator of a dm_control task.
        self._random = np.random.RandomState(seed)

    def initialize_episode(self, physics: CartPolePhysics) -> None:
        """Draw the start and the colours."""
        self._episode_seed, self._slot = int(self._random.randint(2**32, dtype=np.uint64)), 0
        state = self.start.draw(self._episode_seed, DEVICE, DEVICE)[0]
        physics.data.qpos[:], physics.data.qvel[:] = state[:2], state[2:]
        physics.colors = draw_colors(self._episode_seed, DEVICE, DEVICE)[0] if self.random_colors else None

    def action_spec(self, physics: CartPolePhysics) -> specs.BoundedArray:
        """The force in newtons."""
        return specs.BoundedArray((1,), np.float32, -FORCE_LIMIT, FORCE_LIMIT, name="force")

    def before_step(self, action: np.ndarray, physics: CartPolePhysics) -> None:
        """Hold the force for the slot; ValueError if it is not in [-20, 20] N."""
        check_force(np.asarray(action))
        physics.set_control(action)

    def after_step(self, physics: CartPolePhysics) -> None:
        """Add the process noise."""
        if self._noise_std.any():
            drawn = normals(self._episode_seed, NOISE, DEVICE, DEVICE, np.array([self._slot]))[0]
            physics.data.qvel[:] += self._noise_std * drawn
        self._slot += 1

    def get_observation(self, physics: CartPolePhysics) -> dict[str, np.ndarray]:
        """The state, float32 [4]."""
        return {STATE_KEY: physics.state().astype(np.float32)}

    def get_reward(self, physics: CartPolePhysics) -> float:
        """1 in the box, else 0."""
        return float(in_box(physics.state()))

    def get_termination(self, physics: CartPolePhysics) -> float | None:
        """Discount 0 on failure, None to go on."""
        return 0.0 if has_failed(physics.state()) else None
