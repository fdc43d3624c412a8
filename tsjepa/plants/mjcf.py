"""A MuJoCo model in a file as a plant, described by a table in a recipe."""

from __future__ import annotations

import functools
import inspect
import math
import os
from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor, nn

from tsjepa.plants.lqr import ClippedLQR
from tsjepa.plants.mujoco_plant import MujocoPlant
from tsjepa.plants.policies import Rest, load_policy
from tsjepa.plants.streams import START, uniforms
from tsjepa.support.spec import PlantSpec

RATE_WEIGHT = 0.1  # of a rate in the regulator's cost; a position's is 1 over the square of its limit in ``failure``


class MuJoCo(MujocoPlant):
    """A machine from an MJCF file, held where it stands.

    The state counts from the pose in which the machine stands, which is all zeros: for each joint in ``state`` its
    position (of a free joint x, y, z and the turn rx, ry, rz), then the rates, then the sensors. One coordinate of a
    joint is named as in ``spec.state_names``, such as ``base_ry``. Actuators that ``action`` does not name rest at 0.

    Args:
        xml: path of the file that includes the others; one below ``recipes/`` is found where recipes are.
        slot: seconds between commands.
        action: lowest and highest command of each actuator that is used.
        state: joints, coordinates of joints, or sensors; all joints by default.
        start: half-width of the uniform start of each coordinate about the pose; 0 for the others.
        score: limit of each coordinate that counts: a slot scores 1 where all are within, else 0.
        failure: limit of each coordinate beyond which the machine is lost.
        camera: "auto", or the name of one of the model's.
        expert: "lqr", a module or the file of a policy (:func:`tsjepa.plants.policies.load_policy`), or None for none.
        integrator: Euler, RK4, implicit or implicitfast, with steps of at most 2 ms; by default the file's own, with
            its own steps.
        settle: seconds for which the machine is left alone before the pose is taken, for one that starts in the air.
        pose: before that, the joints' positions: a keyframe's name, or changes to the file's pose by coordinate.
        frame: height and width of a picture in pixels.
        process_noise_std: noise on the rates after every slot.

    Raises:
        ValueError: the file cannot be read, a name is not in it, or with "lqr" there is no regulator: the machine is in
            the air or does not stand still, or something grows that no command moves.
    """

    def __init__(
        self,
        xml: str | os.PathLike,
        slot: float,
        action: Mapping[str, Sequence[float]],
        state: Sequence[str] | None = None,
        start: Mapping[str, float] | None = None,
        score: Mapping[str, float] | None = None,
        failure: Mapping[str, float] | None = None,
        camera: str = "auto",
        expert: nn.Module | str | os.PathLike | None = "lqr",
        integrator: str | None = None,
        settle: float = 0.0,
        pose: str | Mapping[str, float] | None = None,
        frame: tuple[int, int] = (64, 64),
        process_noise_std: float = 0.0,
    ) -> None:
        given = locals()
        self.init_args = {name: given[name] for name in inspect.signature(MuJoCo).parameters} | {"xml": str(xml)}
        from tsjepa.plants.auto_camera import auto_view, named_view, visited
        from tsjepa.plants.mjcf_model import Coordinates, load_model, settled

        model = load_model(xml, action, integrator)
        pose_at_rest, self.stands = settled(model, pose, settle)
        self.coordinates = coordinates = Coordinates(model, pose_at_rest, state)
        self.widths, self.score_limits, self.failure_limits = dict(start or {}), dict(score or {}), dict(failure or {})
        coordinates.check("start", self.widths, coordinates.all_names)
        coordinates.check("score", self.score_limits, coordinates.names)
        coordinates.check("failure", self.failure_limits, coordinates.names)
        spec = PlantSpec(
            action_low=tuple(float(low) for low, _ in action.values()),
            action_high=tuple(float(high) for _, high in action.values()),
            slot=slot,
            frame=(frame[0], frame[1]),
            state_names=tuple(coordinates.names),
            state_units=tuple(coordinates.units),
            state_scale=tuple(float(self.failure_limits.get(name, 1.0)) for name in coordinates.names),
            action_names=tuple(action),
        )
        if camera == "auto":
            poses = visited(model, pose_at_rest, {**self.widths, **self.failure_limits})
            view = auto_view(model, poses, coordinates.joints, spec.frame)
        else:
            view = named_view(model, camera, pose_at_rest)
        super().__init__(model, spec, view, [0.0] * (model.nq + model.nv), process_noise_std)
        self.actuators = [model.actuator(name).id for name in action]
        if expert == "lqr":
            self.expert = self._regulator()
        elif expert is None:
            self.expert = Rest(spec.rest)
        else:
            self.expert = load_policy(expert, spec.action_low, spec.action_high)

    def start(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """Uniform about the pose."""
        names = self.coordinates.all_names
        widths = np.array([self.widths.get(name, 0.0) for name in names])
        draws = uniforms(seed, START, device, episode, count=len(names))
        return self.coordinates.physics((2.0 * draws - 1.0) * widths)

    def control(self, action: np.ndarray) -> np.ndarray:
        """The actuators that are not named rest."""
        control = np.zeros((len(action), self.model.nu))
        control[:, self.actuators] = action
        return control

    def state(self, physics: np.ndarray) -> np.ndarray:
        """Displacements from the pose, rates, sensors."""
        return self.coordinates.state(physics)

    def score(self, state, reference=None):
        """1 where every coordinate in ``score`` is within its limit, else 0."""
        return ~self._beyond(state, self.score_limits)

    def failed(self, state):
        """A coordinate is beyond its limit in ``failure``."""
        return self._beyond(state, self.failure_limits)

    def _beyond(self, state, limits: Mapping[str, float]):
        beyond = state[..., 0] > math.inf
        for name, limit in limits.items():
            beyond = beyond | (abs(state[..., self.spec.state_names.index(name)]) > limit)
        return beyond

    def linear(self) -> tuple[Tensor, Tensor] | None:
        """Central differences about the pose; None where the stated coordinates do not decide how they go on."""
        try:
            return self._linear
        except ValueError:
            return None

    @functools.cached_property
    def _linear(self) -> tuple[Tensor, Tensor]:
        from tsjepa.plants.equilibrium import jacobians, reduced

        a, b = jacobians(self._a_slot_later, 2 * self.model.nv, self.spec.action_dim)
        return reduced(a, b, self.coordinates.jacobian(), self.coordinates.all_names)

    def _a_slot_later(self, displacement: np.ndarray, action: np.ndarray) -> np.ndarray:
        physics = self.stepper.advance(self.coordinates.physics(displacement), self.control(action))
        return self.coordinates.displacement(physics)

    def _regulator(self) -> nn.Module:
        from tsjepa.plants.equilibrium import balancing_gain, check_equilibrium

        spec, size = self.spec, 2 * self.model.nv
        still = self._a_slot_later(np.zeros((1, size)), np.zeros((1, spec.action_dim)))[0]
        check_equilibrium(still, self.coordinates.all_names, self.stands)
        rates = [name not in self.coordinates.all_names[: self.model.nv] for name in spec.state_names]
        weights = [RATE_WEIGHT if rate else scale**-2 for rate, scale in zip(rates, spec.state_scale, strict=True)]
        effort = [(2 / span) ** 2 for span in spec.action_range]
        gain = balancing_gain(*self._linear, weights, effort, spec.state_names)
        return ClippedLQR(gain, math.inf, spec.action_low, spec.action_high)

    def experts(self) -> dict[str, nn.Module]:
        """The regulator, or what was given."""
        return {"expert": self.expert}
