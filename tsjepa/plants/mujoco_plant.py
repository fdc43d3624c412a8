"""A plant that MuJoCo computes and draws; a machine on it adds names, start, state, score, failure and experts."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from tsjepa.plants.lens import View
from tsjepa.plants.plant import Plant
from tsjepa.plants.streams import COLOR, NOISE, REFERENCE, START, normals, uniforms
from tsjepa.support.spec import PlantSpec

if TYPE_CHECKING:  # training from a data set needs the specs and experts of this room, but not MuJoCo
    import mujoco

DARKEST = 0.25  # of a colour's components, so that it shows on black
DIFFERENCE = 1e-5  # of the finite differences, in the state's and the command's units


class MujocoPlant(Plant):
    """The part of a plant that follows from a MuJoCo model; see :class:`tsjepa.plants.plant.Plant` for its methods.

    The physics is [N, nq + nv + na]: joint positions, velocities, activations. Its scene is the positions, then RGB of
    every moving geom. A subclass has ``state``, ``score``, ``failed`` and ``experts``, and may replace the rest.

    Args:
        model: with a camera called "view", or else its first one; its timestep is set to fill the slot.
        spec: names, units and ranges.
        view: the camera.
        start_half_widths: of the uniform start about zero, [nq + nv], in metres, radians and per second.
        process_noise_std: noise added to the velocities after every slot: one number or one a velocity.
        random_colors: draw the colour of every moving part for each device and episode.

    Raises:
        ValueError: a half-width or a standard deviation that is negative, not finite, or not one for each.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        spec: PlantSpec,
        view: View,
        start_half_widths: Sequence[float] | np.ndarray,
        process_noise_std: float | Sequence[float] = 0.0,
        random_colors: bool = False,
    ) -> None:
        self.model, self.spec, self.view, self.random_colors = model, spec, view, random_colors
        self.start_half_widths = _positive("start_half_widths", start_half_widths, model.nq + model.nv)
        self.process_noise_std = _positive("process_noise_std", process_noise_std, model.nv)
        self._colors_of: tuple | None = None
        place_camera(model, view)

    def __getstate__(self) -> dict:
        """Another process makes its own GL context and threads."""
        return {name: value for name, value in self.__dict__.items() if name not in ("stepper", "renderer")}

    @functools.cached_property
    def stepper(self):
        """See :class:`tsjepa.plants.stepping.Stepper`."""
        from tsjepa.plants.stepping import Stepper

        return Stepper(self.model, self.spec.slot)

    @functools.cached_property
    def renderer(self):
        """See :class:`tsjepa.plants.renderer.Renderer`."""
        from tsjepa.plants.renderer import Renderer

        return Renderer(self.model, self.view, *self.spec.frame)

    def start(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """Uniform about zero."""
        count = len(self.start_half_widths)
        return (2.0 * uniforms(seed, START, device, episode, count=count) - 1.0) * self.start_half_widths

    def advance(self, physics, action, seed, device, episode, slot) -> np.ndarray:
        """One slot with the command held, then the noise on the velocities."""
        check_action(action, self.spec)
        physics = self.stepper.advance(physics, self.control(action))
        if self.process_noise_std.any():
            nq, nv = self.model.nq, self.model.nv
            physics[:, nq : nq + nv] += self.process_noise_std * normals(seed, NOISE, device, episode, slot, nv)
        return physics

    def control(self, action: np.ndarray) -> np.ndarray:
        """What the model's actuators [N, nu] are given for commands [N, m]."""
        return action

    def scene(self, physics, seed, device, episode) -> np.ndarray:
        """Joint positions, then RGB of every moving geom."""
        colors = np.broadcast_to(self.colors.reshape(1, -1), (len(physics), self.colors.size))
        if self.random_colors:
            colors = self._drawn_colors(seed, device, episode)
        return np.concatenate([physics[:, : self.model.nq], colors], axis=1).astype(np.float32)

    def _drawn_colors(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """RGB [N, 3 parts] of an episode; the last ones are kept, because a fleet asks for them in every slot."""
        wanted = seed, device.tobytes(), episode.tobytes()
        if self._colors_of != wanted:
            parts = [uniforms(seed, COLOR + part, device, episode, count=3) for part in range(len(self.colors))]
            self._colors_of, self._last_colors = wanted, DARKEST + (1.0 - DARKEST) * np.concatenate(parts, axis=-1)
        return self._last_colors

    @functools.cached_property
    def colors(self) -> np.ndarray:
        """RGB [parts, 3] of the moving geoms as the model has them."""
        from tsjepa.plants.renderer import geom_colors, moving_geoms

        return geom_colors(self.model, moving_geoms(self.model))

    def render(self, scene: np.ndarray) -> np.ndarray:
        """Pictures uint8 [N, H, W, 3]."""
        colors = scene[:, self.model.nq :].reshape(len(scene), -1, 3)
        return self.renderer.render(scene[:, : self.model.nq], colors)

    def camera(self) -> dict:
        """See :meth:`tsjepa.plants.renderer.Renderer.metadata`."""
        return self.renderer.metadata()

    def linear(self) -> tuple[Tensor, Tensor] | None:
        """As :meth:`linearised`; None in a plant whose state has no linear model."""
        return self.linearised()

    def linearised(self) -> tuple[Tensor, Tensor]:
        """Central differences about zero, for machines whose state is their physics."""
        size, width = self.model.nq + self.model.nv, self.spec.action_dim
        steps = DIFFERENCE * np.eye(size + width)
        points = np.concatenate([steps, -steps])
        after = self.stepper.advance(points[:, :size], points[:, size:])
        jacobian = torch.from_numpy((after[: size + width] - after[size + width :]).T / (2 * DIFFERENCE))
        return jacobian[:, :size].contiguous(), jacobian[:, size:].contiguous()


def place_camera(model: mujoco.MjModel, view: View) -> None:
    """Fixes the model's camera "view" (or its first) to the world."""
    from tsjepa.plants.renderer import view_camera

    camera = view_camera(model)
    model.cam_bodyid[camera], model.cam_mode[camera] = 0, 0
    model.cam_pos[camera], model.cam_quat[camera] = view.position, view.quaternion()
    model.cam_fovy[camera], model.cam_ipd[camera] = view.fovy, view.eyes


def check_action(action: np.ndarray, spec: PlantSpec) -> None:
    """Refuses commands [N, m] outside the actuator's range.

    Raises:
        ValueError: naming the value; NaN is outside too.
    """
    low, high = np.array(spec.action_low), np.array(spec.action_high)
    bad = ~((action >= low) & (action <= high))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        unit = spec.action_units[column] if spec.action_units else ""
        raise ValueError(
            f"A command must lie in [{low[column]:g}, {high[column]:g}] {unit}, got {action[row, column]}; clip the "
            "command before the plant."
        )


def changing_goals(
    low: Sequence[float],
    high: Sequence[float],
    episodes: int,
    slots: int,
    generator: torch.Generator,
    hold_slots: int = 25,
    change_probability: float = 0.7,
) -> Tensor:
    """Set-points [episodes, slots, r] that start at 0 and may change now and then to a uniform draw.

    Args:
        low, high: [r], range of the draws.
        episodes, slots: how many.
        generator: of the draws.
        hold_slots: a set-point may change every this many slots.
        change_probability: chance that it does.
    """
    lowest, highest = torch.tensor(low), torch.tensor(high)
    holds = math.ceil(slots / hold_slots)
    goals, held = [], torch.zeros(episodes, len(lowest))
    for _ in range(holds):
        change = torch.rand(episodes, 1, generator=generator) < change_probability
        drawn = lowest + (highest - lowest) * torch.rand(episodes, len(lowest), generator=generator)
        held = torch.where(change, drawn, held)
        goals.append(held)
    return torch.stack(goals, 1).repeat_interleave(hold_slots, 1)[:, :slots]


def jumping_set_point(
    seed: int, device: np.ndarray, episode: np.ndarray, slot: np.ndarray, step: float, hold_slots: int
) -> np.ndarray:
    """Set-points [N, 1] that are drawn anew, plus or minus ``step``, every ``hold_slots`` slots."""
    if step == 0:
        return np.zeros((*np.broadcast_shapes(device.shape, episode.shape, slot.shape), 1))
    return step * np.sign(uniforms(seed, REFERENCE, device, episode, slot // hold_slots, 1) - 0.5)


def _positive(name: str, value: float | Sequence[float] | np.ndarray, count: int) -> np.ndarray:
    values = np.asarray(value, np.float64)
    if values.shape not in ((), (count,)) or not (np.isfinite(values) & (values >= 0)).all():
        raise ValueError(f"{name} must be one or {count} finite numbers that are not negative, got {value!r}.")
    return np.broadcast_to(values, (count,))
