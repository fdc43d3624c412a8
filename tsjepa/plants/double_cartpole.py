"""dm_control's cart with two poles in series: hold the cart at the wanted position and both poles upright."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.plants.appearance import Appearance
from tsjepa.plants.cartpole import MAX_FORCE, in_newtons
from tsjepa.plants.lens import View
from tsjepa.plants.lqr import ClippedLQR, lqr_gain
from tsjepa.plants.mujoco_plant import MujocoPlant, changing_goals, jumping_set_point
from tsjepa.plants.suite_models import load_suite_model
from tsjepa.support.spec import PlantSpec

# Wider than the cart-pole's box: a stack of two poles turns a millimetre at its foot into three times the command.
BOX_POSITION, BOX_ANGLE = 0.2, 0.1  # m, rad from the vertical
FAILURE_POSITION, FAILURE_ANGLE = 1.8, 0.8  # m, rad from the vertical; the rail ends at 1.8 m
# From wider starts not even a regulator that knows the state saves every machine.
START_HALF_WIDTHS = (0.4, 0.05, 0.05, 0.1, 0.1, 0.1)  # m, rad, rad, m/s, rad/s, rad/s
GOAL_RANGE = 0.5  # m, of the set-points that trajectories of the training data have
# 2.2 m high, from below the cart to above the upper pole; rolled so that edges fall on many sub-pixel phases.
VIEW = View(position=(0.0, -6.0, 1.97), fovy=22.6, roll=3.0)


class DoubleCartPole(MujocoPlant):
    """The suite's cart with two poles, its force in newtons within +-20.

    State (x m, hinge 1 rad, hinge 2 rad and their rates); the second hinge is measured from the first pole, 0 in line
    with it. The score is 1 where the position is within 20 cm of the reference and both poles are within 0.1 rad of the
    vertical; with the cart beyond 1.8 m or a pole beyond 0.8 rad it has failed.

    Args:
        sampling_interval: slot in seconds.
        process_noise_std: noise on the three rates after every slot, m/s and rad/s.
        random_colors: draw colours for each device and episode.
        start_half_widths: of the uniform start (m, rad, rad, m/s, rad/s, rad/s).
        set_point_step: the wanted position jumps between plus and minus this, metres; 0 keeps it at the origin.
        set_point_slots: slots between jumps.
        appearance: what else is drawn for each of them; None for nothing.
    """

    normaliser = "reference LQR"

    def __init__(
        self,
        sampling_interval: float = 0.02,
        process_noise_std: float | Sequence[float] = 0.0,
        random_colors: bool = False,
        start_half_widths: Sequence[float] = START_HALF_WIDTHS,
        set_point_step: float = 0.0,
        set_point_slots: int = 50,
        appearance: Appearance | None = None,
    ) -> None:
        spec = PlantSpec(
            action_low=(-MAX_FORCE,),
            action_high=(MAX_FORCE,),
            slot=sampling_interval,
            frame=(96, 128),
            state_names=("x", "hinge_1", "hinge_2", "x_dot", "hinge_1_dot", "hinge_2_dot"),
            state_units=("m", "rad", "rad", "m/s", "rad/s", "rad/s"),
            state_scale=(1.8, 0.8, 0.8, 4.0, 6.0, 6.0),
            action_names=("force",),
            action_units=("N",),
            reference_names=("x",),
            reference_units=("m",),
            reference_low=(-GOAL_RANGE,),
            reference_high=(GOAL_RANGE,),
            watched="hinge_1",
            watched_limit=BOX_ANGLE,
        )
        model = load_suite_model("cartpole", in_newtons, num_poles=2)
        super().__init__(model, spec, VIEW, start_half_widths, process_noise_std, random_colors, appearance)
        self.sampling_interval = sampling_interval
        self.set_point_step, self.set_point_slots = set_point_step, set_point_slots

    def state(self, physics: np.ndarray) -> np.ndarray:
        """The physics itself."""
        return physics

    def references(self, seed, device, episode, slot) -> np.ndarray:
        """The wanted position [N, 1] in metres."""
        return jumping_set_point(seed, device, episode, slot, self.set_point_step, self.set_point_slots)

    def score(self, state, reference=None):
        """1 in the box about the reference, else 0."""
        wanted = 0.0 if reference is None else reference[..., 0]
        return (abs(state[..., 0] - wanted) <= BOX_POSITION) & self._upright(state, BOX_ANGLE)

    def failed(self, state):
        """A pole has fallen, or the cart is at the end of its rail."""
        return (abs(state[..., 0]) > FAILURE_POSITION) | ~self._upright(state, FAILURE_ANGLE)

    def _upright(self, state, limit: float):
        return (abs(state[..., 1]) <= limit) & (abs(state[..., 1] + state[..., 2]) <= limit)

    def experts(self) -> dict[str, nn.Module]:
        """Two regulators solved for the slot, position error clipped at 0.5 m.

        ``reference LQR`` has Q = diag(1, 1, 1, 0.1, 0.1, 0.1), R = 1e-3. ``expert``, Q = diag(1.6, 1, 1, 0.005, 0.005,
        0.005), R = 1e-2, scores 0.97 of it on the true state, with half of its command for an error of the state: on a
        state that is read from pictures it does better, and no machine falls.
        """
        a, b = self.linearised()
        low, high = self.spec.action_low, self.spec.action_high
        return {
            "expert": ClippedLQR(lqr_gain(a, b, (1.6, 1.0, 1.0, 0.005, 0.005, 0.005), 1e-2), 0.5, low, high),
            "reference LQR": ClippedLQR(lqr_gain(a, b, (1.0, 1.0, 1.0, 0.1, 0.1, 0.1), 1e-3), 0.5, low, high),
        }

    def goals(self, episodes: int, slots: int, generator: torch.Generator) -> Tensor:
        """Wanted positions [episodes, slots, 1] in metres."""
        return changing_goals(self.spec.reference_low, self.spec.reference_high, episodes, slots, generator)
