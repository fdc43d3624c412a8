"""dm_control's view of the cart-pole, with the fast camera in place of the one that rebuilds its scene every frame."""

from __future__ import annotations

import numpy as np
import torchrl  # noqa: F401  (before dm_control: see tsjepa.envs)
from dm_control.mujoco import Physics
from dm_control.mujoco.wrapper import MjModel

from tsjepa.envs.camera import HEIGHT, VIEW, WIDTH, Renderer, apply_view
from tsjepa.envs.dynamics import load_model


class CartPolePhysics(Physics):
    """Cart-pole physics that renders through one persistent `Renderer`.

    `colors` ([2, 3] RGB in [0, 1] of cart and pole, or None for the default) is what the next frame shows.
    """

    colors: np.ndarray | None = None
    _renderer: Renderer | None = None

    @classmethod
    def for_interval(cls, sampling_interval: float = 0.02) -> CartPolePhysics:
        """Physics whose timestep divides `sampling_interval` (seconds)."""
        model = load_model(sampling_interval)
        apply_view(model, VIEW, HEIGHT, WIDTH)
        return cls.from_model(MjModel(model))

    def state(self) -> np.ndarray:
        """(x, theta, x_dot, theta_dot), float64 [4]."""
        return np.concatenate([self.data.qpos, self.data.qvel])

    def render(self, height: int = HEIGHT, width: int = WIDTH, camera_id: int | str = 0, **options) -> np.ndarray:
        """One uint8 frame [height, width, 3]; another camera or dm_control's options take dm_control's slow path."""
        if camera_id not in (0, "view") or options:
            return super().render(height, width, camera_id, **options)
        if self._renderer is None or (self._renderer.height, self._renderer.width) != (height, width):
            self._renderer = Renderer(height, width)
        colors = None if self.colors is None else self.colors[None]
        return self._renderer.render(self.data.qpos[None], colors)[0]
