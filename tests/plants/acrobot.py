"""The suite's acrobot as somebody would write it from the docs page alone: two links, one motor, held upright."""

import torchrl  # noqa: F401  (before dm_control)

from tsjepa.plants import MujocoPlant, PlantSpec
from tsjepa.plants.lens import View
from tsjepa.plants.lqr import ClippedLQR, lqr_gain
from tsjepa.plants.suite_models import load_suite_model, simplify


def on_black(spec):
    """The suite's model without its floor and target."""
    simplify(spec, hide=("floor",), colors={})


class Acrobot(MujocoPlant):
    """Two links in series; only the elbow is driven. State: shoulder and elbow (rad from upright) and their rates."""

    def __init__(self, sampling_interval=0.01, process_noise_std=0.0, start_half_widths=(0.005, 0.005, 0.005, 0.005)):
        spec = PlantSpec(
            action_low=(-1.0,),
            action_high=(1.0,),
            slot=sampling_interval,
            frame=(64, 64),
            state_names=("shoulder", "elbow", "shoulder_rate", "elbow_rate"),
            state_units=("rad", "rad", "rad/s", "rad/s"),
            state_scale=(0.5, 0.5, 2.0, 4.0),
            action_names=("elbow",),
            action_units=("2 N m",),
        )
        view = View(position=(0.0, -6.0, 3.0), fovy=22.0, roll=5.0)
        super().__init__(load_suite_model("acrobot", on_black), spec, view, start_half_widths, process_noise_std)
        self.sampling_interval = sampling_interval

    def state(self, physics):
        return physics

    def score(self, state, reference=None):
        return (abs(state[..., 0]) <= 0.02) & (abs(state[..., 1]) <= 0.04)

    def failed(self, state):
        return (abs(state[..., 0]) > 0.5) | (abs(state[..., 1]) > 1.0)

    def experts(self):
        a, b = self.linear()
        gain = lqr_gain(a, b, (1.0, 1.0, 0.1, 0.1), 1.0)
        return {"expert": ClippedLQR(gain, float("inf"), self.spec.action_low, self.spec.action_high)}
