"""dm_control's pendulum: swing it up with a motor that cannot lift it, and hold it there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.plants.appearance import Appearance
from tsjepa.plants.lens import View
from tsjepa.plants.lqr import lqr_gain
from tsjepa.plants.mujoco_plant import MujocoPlant
from tsjepa.plants.suite_models import load_suite_model, simplify
from tsjepa.support.spec import PlantSpec

if TYPE_CHECKING:
    import mujoco

MAX_TORQUE = 1.0  # newton metres, a fifth of what gravity exerts on the horizontal pole
MASS, LENGTH, GRAVITY = 1.0, 0.5, 9.81  # kg, m, m/s^2 of the suite's model
WEIGHT, INERTIA = MASS * GRAVITY * LENGTH, MASS * LENGTH**2  # N m, kg m^2 (a point mass)
UPRIGHT = math.cos(math.radians(8.0))  # the suite's own
CAPTURE_ANGLE = 0.35  # rad, within which the regulator takes over
VIEW = View(position=(0.0, -4.0, 0.6), fovy=17.0, roll=5.0)


def without_floor(spec: mujoco.MjSpec) -> None:
    """The suite's pendulum on black."""
    simplify(spec, hide=("floor",), colors={})


class SwingUp(nn.Module):
    """Pumps energy until the pole reaches the top, and regulates it there.

    Far from the top the torque is along the rate while the energy is below that of standing upright, and against it
    above (Astrom and Furuta, "Swinging up a pendulum by energy control", 2000).

    Args:
        gain: K [1, 2] for the torque -K (angle, rate) near the top.
    """

    def __init__(self, gain: Tensor) -> None:
        super().__init__()
        self.register_buffer("gain", torch.as_tensor(gain, dtype=torch.float64))

    def forward(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        """Torque [..., 1] for states [..., 3]: cosine and sine of the angle from the top, rate in rad/s."""
        cosine, sine, rate = state.unbind(-1)
        angle = torch.atan2(sine, cosine)
        lacking = WEIGHT * (1.0 - cosine) - 0.5 * INERTIA * rate**2
        # a pole that hangs still has to be pushed to one side
        along = torch.where(rate >= 0, 1.0, -1.0)
        pump = MAX_TORQUE * along * torch.sign(lacking)
        hold = -(self.gain[0, 0].to(state) * angle + self.gain[0, 1].to(state) * rate)
        torque = torch.where(angle.abs() < CAPTURE_ANGLE, hold, pump)
        return torque.clamp(-MAX_TORQUE, MAX_TORQUE).unsqueeze(-1)


class Pendulum(MujocoPlant):
    """The suite's swing-up, its torque within +-1 N m.

    State: cosine and sine of the angle from the top, rate in rad/s. The score is 1 within 8 degrees of the top; it
    never fails. From rest at the bottom it takes 6 to 8 s, so an episode wants 500 slots of 20 ms.

    Args:
        sampling_interval: slot in seconds.
        process_noise_std: noise on the rate after every slot, rad/s.
        random_colors: draw colours for each device and episode.
        start_half_widths: of the uniform start (rad from the top, rad/s).
        appearance: what else is drawn for each of them; None for nothing.
    """

    def __init__(
        self,
        sampling_interval: float = 0.02,
        process_noise_std: float | Sequence[float] = 0.0,
        random_colors: bool = False,
        start_half_widths: Sequence[float] = (math.pi, 0.0),
        appearance: Appearance | None = None,
    ) -> None:
        spec = PlantSpec(
            action_low=(-MAX_TORQUE,),
            action_high=(MAX_TORQUE,),
            slot=sampling_interval,
            frame=(64, 64),
            state_names=("cos", "sin", "rate"),
            state_units=("1", "1", "rad/s"),
            state_scale=(1.0, 1.0, 10.0),
            action_names=("torque",),
            action_units=("N m",),
            watched="sin",
            watched_limit=math.sin(math.radians(8.0)),
        )
        model = load_suite_model("pendulum", without_floor)
        super().__init__(model, spec, VIEW, start_half_widths, process_noise_std, random_colors, appearance)
        self.sampling_interval = sampling_interval

    def state(self, physics: np.ndarray) -> np.ndarray:
        """Cosine and sine of the angle, rate."""
        return np.stack((np.cos(physics[:, 0]), np.sin(physics[:, 0]), physics[:, 1]), axis=1)

    def score(self, state, reference=None):
        """1 within 8 degrees of the top, else 0."""
        return state[..., 0] >= UPRIGHT

    def linear(self) -> None:
        """None: a state on a circle has no linear model."""
        return None

    def experts(self) -> dict[str, nn.Module]:
        """Energy pumping and, near the top, the regulator for Q = diag(1, 0.1), R = 0.1."""
        a, b = self.linearised()
        return {"expert": SwingUp(lqr_gain(a, b, (1.0, 0.1), 0.1))}
