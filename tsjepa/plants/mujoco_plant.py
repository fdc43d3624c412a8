"""A plant that MuJoCo computes and draws; a machine on it adds names, start, state, score, failure and experts."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from tsjepa.plants.appearance import Appearance, bright
from tsjepa.plants.lens import View
from tsjepa.plants.plant import Plant
from tsjepa.plants.streams import COLOR, NOISE, REFERENCE, START, normals, uniforms
from tsjepa.support.spec import PlantSpec

if TYPE_CHECKING:  # training from a data set needs the specs and experts of this room, but not MuJoCo
    import mujoco

DIFFERENCE = 1e-5  # of the finite differences, in the state's and the command's units


class MujocoPlant(Plant):
    """The part of a plant that follows from a MuJoCo model; see :class:`tsjepa.plants.plant.Plant` for its methods.

    The physics is [N, nq + nv + na]: joint positions, velocities, activations. Its scene is the positions, RGB of every
    moving geom and what an appearance draws beside them. A subclass has ``state``, ``score``, ``failed`` and
    ``experts``, and may replace the rest.

    Args:
        model: with a camera called "view", or else its first one; its timestep is set to fill the slot.
        spec: names, units and ranges.
        view: the camera.
        start_half_widths: of the uniform start about zero, [nq + nv], in metres, radians and per second.
        process_noise_std: noise added to the velocities after every slot: one number or one a velocity.
        random_colors: draw the colour of every moving part for each device and episode.
        appearance: what else is drawn for each of them.

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
        appearance: Appearance | None = None,
    ) -> None:
        self.model, self.spec, self.view = model, spec, view
        self.random_colors, self.appearance = random_colors, appearance
        self.start_half_widths = _positive("start_half_widths", start_half_widths, model.nq + model.nv)
        self.process_noise_std = _positive("process_noise_std", process_noise_std, model.nv)
        self._looks_of: tuple | None = None
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
        """Joint positions, RGB of every moving geom, and the numbers of the appearance's surroundings."""
        looks = [
            np.broadcast_to(numbers, (len(physics), numbers.shape[-1]))
            for numbers in self._looks(seed, device, episode)
        ]
        return np.concatenate([physics[:, : self.model.nq], *looks], axis=1).astype(np.float32)

    def _looks(self, seed: int, device: np.ndarray, episode: np.ndarray) -> list[np.ndarray]:
        """RGB [N or 1, 3 parts] of an episode, and its surroundings where there are any.

        The last ones are kept, because a fleet asks for them in every slot.
        """
        wanted = seed, device.tobytes(), episode.tobytes()
        if self._looks_of != wanted:
            colors, look = self.colors.reshape(1, -1), self.appearance
            if self.random_colors or (look and look.colors):
                parts = [uniforms(seed, COLOR + part, device, episode, count=3) for part in range(len(self.colors))]
                colors = bright(np.concatenate(parts, axis=-1))
            self._looks_of = wanted
            self._last_looks = [colors, look.draw(seed, device, episode)] if look else [colors]
        return self._last_looks

    @functools.cached_property
    def colors(self) -> np.ndarray:
        """RGB [parts, 3] of the moving geoms as the model has them."""
        from tsjepa.plants.renderer import geom_colors, moving_geoms

        return geom_colors(self.model, moving_geoms(self.model))

    def render(self, scene: np.ndarray) -> np.ndarray:
        """Pictures uint8 [N, H, W, 3]."""
        nq, parts = self.model.nq, self.colors.size
        qpos, colors, looks = (
            scene[:, :nq],
            scene[:, nq : nq + parts].reshape(len(scene), -1, 3),
            scene[:, nq + parts :],
        )
        if self.appearance is None or not looks.size:
            return self.renderer.render(qpos, colors)
        height, width = self.spec.frame
        frames = np.empty((len(scene), height, width, 3), np.uint8)
        each, kind = np.unique(looks, axis=0, return_inverse=True)
        for number, look in enumerate(each):
            rows = np.flatnonzero(kind.ravel() == number)
            around = self.appearance.surroundings(look, width, height)
            frames[rows] = self.renderer.render(qpos[rows], colors[rows], around)
        return frames

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
