"""dm_control's cart-pole: hold the cart at the wanted position and the pole upright."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.plants import cartpole_law
from tsjepa.plants.appearance import Appearance
from tsjepa.plants.bent_lqr import BentLQR
from tsjepa.plants.lens import View
from tsjepa.plants.lqr import ClippedLQR, lqr_gain, lqr_value
from tsjepa.plants.mujoco_plant import MujocoPlant, changing_goals, jumping_set_point
from tsjepa.plants.suite_models import load_suite_model, simplify
from tsjepa.support.spec import PlantSpec

if TYPE_CHECKING:
    import mujoco

MAX_FORCE = 20.0  # newtons
BOX_POSITION, BOX_ANGLE = 0.05, 0.05  # m, rad
FAILURE_POSITION, FAILURE_ANGLE = 1.8, 0.8  # m, rad; the rail ends at 1.8 m
START_HALF_WIDTHS = (0.8, 0.3, 0.3, 0.3)  # m, rad, m/s, rad/s
GOAL_RANGE = 0.8  # m, of the set-points that trajectories of the training data have
POLE_LENGTH = 1.0  # m, the suite's
EXPERT, REFERENCE, SEARCHED, FLEET = "expert", "reference LQR", "searched law", "fleet law"
EXPERT_WEIGHTS = (1.6, 1.0, 0.005, 0.005), 1e-3  # Q's diagonal and R
# A rolled camera meets every edge at many sub-pixel phases, and four samples on a doubled grid make sixteen a pixel:
# two frames 40 ms apart then give velocity to 5 mm/s, against 35 for an upright view with four samples, 49 with none.
# The width just holds the cart and the leaning pole at |x| <= 1.3 m, |theta| <= 0.35 rad. The eyes stand apart by
# MuJoCo's default, because the shipped models have learned from such pictures; it moves an edge by half a pixel.
VIEW = View(position=(0.04, -4.0, 1.45), fovy=24.4, roll=5.0, eyes=0.068)


def in_newtons(spec: mujoco.MjSpec, pole_length: float = POLE_LENGTH) -> None:
    """The suite's cart-pole, of any number of poles, with the force as its command and one box for a rail.

    A length in metres other than the suite's is that of the first pole.
    """
    simplify(spec, hide=("floor", "rail1", "rail2"), colors={})
    spec.worldbody.add_geom(name="rail", type=mujoco_box(), pos=[0, 0, 1], size=[2, 0.02, 0.02], material="decoration")
    motor = spec.actuators[0]
    motor.gear = [1, 0, 0, 0, 0, 0]
    motor.ctrlrange = [-MAX_FORCE, MAX_FORCE]
    if pole_length != POLE_LENGTH:
        spec.geom("pole_1").fromto = [0, 0, 0, 0, 0, pole_length]


def mujoco_box() -> int:
    """MuJoCo's number for a box."""
    import mujoco

    return mujoco.mjtGeom.mjGEOM_BOX


class CartPole(MujocoPlant):
    """The suite's cart-pole with its force in newtons, within +-20.

    State (x m, theta rad, x_dot m/s, theta_dot rad/s), theta = 0 upright. The score is 1 where the position is within
    5 cm of the reference and the angle within 0.05 rad; beyond 1.8 m or 0.8 rad it has failed.

    Args:
        sampling_interval: slot in seconds.
        process_noise_std: noise on (x_dot, theta_dot) after every slot, m/s and rad/s.
        random_colors: draw colours for each device and episode.
        start_half_widths: of the uniform start (m, rad, m/s, rad/s).
        set_point_step: the wanted position jumps between plus and minus this, metres; 0 keeps it at the origin.
        set_point_slots: slots between jumps.
        pole_length: metres from the hinge to the tip; its mass stays 0.1 kg. A shorter pole falls faster.
        expert: name of the law in :meth:`experts` that drives it and that models imitate.
        appearance: what else is drawn for each of them; None for nothing.

    Raises:
        ValueError: a pole that has no length, or a law that this machine does not have.
    """

    normaliser = REFERENCE

    def __init__(
        self,
        sampling_interval: float = 0.02,
        process_noise_std: float | Sequence[float] = 0.0,
        random_colors: bool = False,
        start_half_widths: Sequence[float] = START_HALF_WIDTHS,
        set_point_step: float = 0.0,
        set_point_slots: int = 50,
        pole_length: float = POLE_LENGTH,
        appearance: Appearance | None = None,
        expert: str = EXPERT,
    ) -> None:
        if not 0 < pole_length < np.inf:
            raise ValueError(f"pole_length {pole_length!r} must be a positive number of metres")
        spec = PlantSpec(
            action_low=(-MAX_FORCE,),
            action_high=(MAX_FORCE,),
            slot=sampling_interval,
            frame=(64, 128),
            state_names=("x", "theta", "x_dot", "theta_dot"),
            state_units=("m", "rad", "m/s", "rad/s"),
            state_scale=(1.8, 0.8, 4.0, 4.0),
            action_names=("force",),
            action_units=("N",),
            reference_names=("x",),
            reference_units=("m",),
            reference_low=(-GOAL_RANGE,),
            reference_high=(GOAL_RANGE,),
            watched="theta",
            watched_limit=0.05,
        )
        model = load_suite_model("cartpole", lambda suite: in_newtons(suite, pole_length))
        super().__init__(model, spec, VIEW, start_half_widths, process_noise_std, random_colors, appearance)
        self.sampling_interval = sampling_interval
        self.set_point_step, self.set_point_slots = set_point_step, set_point_slots
        self.pole_length = pole_length
        self.expert = expert
        self.experts()  # says now which there are

    def state(self, physics: np.ndarray) -> np.ndarray:
        """The physics itself."""
        return physics

    def references(self, seed, device, episode, slot) -> np.ndarray:
        """The wanted position [N, 1] in metres."""
        return jumping_set_point(seed, device, episode, slot, self.set_point_step, self.set_point_slots)

    def score(self, state, reference=None):
        """1 in the box about the reference, else 0."""
        wanted = 0.0 if reference is None else reference[..., 0]
        return (abs(state[..., 0] - wanted) <= BOX_POSITION) & (abs(state[..., 1]) <= BOX_ANGLE)

    def failed(self, state):
        """The pole has fallen, or the cart is at the end of its rail."""
        return (abs(state[..., 0]) > FAILURE_POSITION) | (abs(state[..., 1]) > FAILURE_ANGLE)

    def cost(self, state, action, reference=None):
        """The paper's quadratic cost of each slot: (1/2) |s - s_d|^2 + R u^2 / 2 with R = 1e-3."""
        position = state[..., 0] - (0.0 if reference is None else reference[..., 0])
        return 0.5 * (position**2 + (state[..., 1:] ** 2).sum(-1) + 1e-3 * (action**2).sum(-1))

    def experts(self) -> dict[str, nn.Module]:
        """Two regulators solved for the slot, and for slots of 20 ms and a pole of 1 m two laws that score more.

        The paper names a non-linear optimal policy without giving it. ``expert`` has Q = diag(1.6, 1, 0.005, 0.005),
        R = 1e-3, position error clipped at 0.65 m: its weights come from a search (evolution strategy, then a grid)
        over diagonal Q, clips and saturations, scored with and without noise. Its command answers errors in the state
        about half as much as that of ``reference LQR``, Q = diag(10, 10, 0.1, 0.1), R = 1e-3, clipped at 0.5 m.

        ``searched law`` reaches the box sooner than both, with forces that cost four times as much
        (docs/results/experts.md). ``fleet law`` is for machines that are heard of late and seldom
        (docs/results/urgency.md).
        """
        a, b = self.linearised()
        low, high = self.spec.action_low, self.spec.action_high
        laws: dict[str, nn.Module] = {
            EXPERT: ClippedLQR(lqr_gain(a, b, *EXPERT_WEIGHTS), 0.65, low, high),
            REFERENCE: ClippedLQR(lqr_gain(a, b, (10.0, 10.0, 0.1, 0.1), 1e-3), 0.5, low, high),
        }
        if self.sampling_interval == 0.02 and self.pole_length == POLE_LENGTH:
            for name, (gain, clip, terms) in {SEARCHED: cartpole_law.EVERY_SLOT, FLEET: cartpole_law.FLEET}.items():
                heights, *directions = zip(*terms, strict=True)
                laws[name] = BentLQR((gain,), clip, low, high, torch.tensor(directions).mT, [heights])
        if self.expert not in laws:
            raise ValueError(
                f"This cart-pole has no expert {self.expert!r}: choose {', '.join(laws)}; those that were searched for "
                "are for slots of 20 ms and a pole of 1 m."
            )
        return {self.expert: laws[self.expert], **laws}

    def goals(self, episodes: int, slots: int, generator: torch.Generator) -> Tensor:
        """Wanted positions [episodes, slots, 1] in metres."""
        return changing_goals(self.spec.reference_low, self.spec.reference_high, episodes, slots, generator)

    def error_cost(self) -> tuple[Tensor, Tensor]:
        """P of the expert's weights, and the noise on the two velocities."""
        variances = torch.cat((torch.zeros(2), torch.tensor(self.process_noise_std.copy()) ** 2))
        return lqr_value(*self.linearised(), *EXPERT_WEIGHTS), torch.diag(variances)
