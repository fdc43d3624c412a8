"""dm_control's reacher: bring the finger of a two-link arm, seen from above, to a goal that the controller knows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.plants.appearance import Appearance
from tsjepa.plants.lens import View
from tsjepa.plants.mujoco_plant import MujocoPlant
from tsjepa.plants.streams import REFERENCE, uniforms
from tsjepa.plants.suite_models import load_suite_model, simplify
from tsjepa.support.spec import PlantSpec

if TYPE_CHECKING:
    import mujoco

LINK = 0.12  # m, shoulder to wrist and wrist to finger
REACH = 0.025  # m, how near the finger has to be: the radii of finger and goal in the suite's hard task
GOAL_RADIUS = (0.05, 0.20)  # m from the shoulder, as in the suite
STIFFNESS, DAMPING = 8.0, 0.5  # of the range of the command, per rad and per rad/s
VIEW = View(position=(0.0, 0.0, 2.0), fovy=15.0, pitch=90.0)


def arm_alone(spec: mujoco.MjSpec) -> None:
    """The suite's arm without its target, floor and walls."""
    simplify(spec, hide=("ground", "wall_x", "wall_y", "wall_neg_x", "wall_neg_y", "target"), colors={})


def finger(state):
    """Where the finger is, x and y in metres, of states [..., 5] as arrays or tensors."""
    functions = torch if isinstance(state, Tensor) else np
    cosine, sine, wrist = state[..., 0], state[..., 1], state[..., 2]
    along, across = LINK * (1.0 + functions.cos(wrist)), LINK * functions.sin(wrist)
    return cosine * along - sine * across, sine * along + cosine * across


class ReachingArm(nn.Module):
    """Inverse kinematics, and a proportional-derivative law to the angles that they give.

    Two postures reach every goal, and their mean reaches nothing; it keeps the one to whose side the wrist is bent.
    """

    def forward(self, state: Tensor, reference: Tensor) -> Tensor:
        """Command [..., 2] in -1..1 for states [..., 5] and goals [..., 2] in metres."""
        goal_x, goal_y = reference.to(state).unbind(-1)
        bent = ((goal_x**2 + goal_y**2) / (2 * LINK**2) - 1.0).clamp(-1.0, 1.0)
        wrist = torch.where(state[..., 2] >= 0, 1.0, -1.0).to(state) * torch.acos(bent)
        shoulder = torch.atan2(goal_y, goal_x) - wrist / 2  # links of one length
        error = shoulder - torch.atan2(state[..., 1], state[..., 0])
        error = torch.atan2(torch.sin(error), torch.cos(error))
        errors = torch.stack((error, wrist - state[..., 2]), dim=-1)
        return (STIFFNESS * errors - DAMPING * state[..., 3:]).clamp(-1.0, 1.0)


class Reacher(MujocoPlant):
    """The suite's two-link arm; its two commands of +-1 are torques of +-0.05 N m.

    State: cosine and sine of the shoulder, angle of the wrist, both rates in rad/s. The reference is the goal (x, y) in
    metres, which no picture shows. The score is 1 where the finger is within 2.5 cm of it, as in the suite's hard task;
    the arm never fails.

    Args:
        sampling_interval: slot in seconds.
        process_noise_std: noise on the two rates after every slot, rad/s.
        random_colors: draw colours for each device and episode.
        start_half_widths: of the uniform start (rad, rad, rad/s, rad/s); the wrist's joint ends at 2.79 rad.
        goal_slots: slots after which the goal is drawn anew; 0 for one goal an episode.
        appearance: what else is drawn for each of them; None for nothing.
    """

    def __init__(
        self,
        sampling_interval: float = 0.02,
        process_noise_std: float | Sequence[float] = 0.0,
        random_colors: bool = False,
        start_half_widths: Sequence[float] = (math.pi, 2.7, 0.0, 0.0),
        goal_slots: int = 50,
        appearance: Appearance | None = None,
    ) -> None:
        reach = GOAL_RADIUS[1]
        spec = PlantSpec(
            action_low=(-1.0, -1.0),
            action_high=(1.0, 1.0),
            slot=sampling_interval,
            frame=(64, 64),
            state_names=("shoulder_cos", "shoulder_sin", "wrist", "shoulder_rate", "wrist_rate"),
            state_units=("1", "1", "rad", "rad/s", "rad/s"),
            state_scale=(1.0, 1.0, 2.8, 10.0, 20.0),
            action_names=("shoulder", "wrist"),
            action_units=("0.05 N m", "0.05 N m"),
            reference_names=("x", "y"),
            reference_units=("m", "m"),
            reference_low=(-reach, -reach),
            reference_high=(reach, reach),
            watched="wrist",
            watched_limit=0.1,
        )
        model = load_suite_model("reacher", arm_alone)
        super().__init__(model, spec, VIEW, start_half_widths, process_noise_std, random_colors, appearance)
        self.sampling_interval, self.goal_slots = sampling_interval, goal_slots

    def state(self, physics: np.ndarray) -> np.ndarray:
        """The shoulder turns without end, so it is given by cosine and sine."""
        return np.concatenate([np.cos(physics[:, :1]), np.sin(physics[:, :1]), physics[:, 1:]], axis=1)

    def references(self, seed, device, episode, slot) -> np.ndarray:
        """Goals [N, 2] in metres, radius and direction uniform as in the suite."""
        goal = slot // self.goal_slots if self.goal_slots else np.zeros_like(slot)
        draws = uniforms(seed, REFERENCE, device, episode, goal, 2)
        return np.stack(_at(draws[..., 0], draws[..., 1], np), axis=-1)

    def score(self, state, reference):
        """1 where the finger is within 2.5 cm of the goal, else 0."""
        x, y = finger(state)
        return (x - reference[..., 0]) ** 2 + (y - reference[..., 1]) ** 2 <= REACH**2

    def linear(self) -> None:
        """None: the goal is everywhere."""
        return None

    def experts(self) -> dict[str, nn.Module]:
        """See :class:`ReachingArm`."""
        return {"expert": ReachingArm()}

    def goals(self, episodes: int, slots: int, generator: torch.Generator) -> Tensor:
        """Goals [episodes, slots, 2] in metres, drawn anew every ``goal_slots`` slots."""
        held = self.goal_slots or slots
        draws = torch.rand(2, episodes, math.ceil(slots / held), generator=generator)
        goals = torch.stack(_at(draws[0], draws[1], torch), dim=-1)
        return goals.repeat_interleave(held, dim=1)[:, :slots]


def _at(radius, direction, functions):
    """x and y in metres of draws in 0..1."""
    near, far = GOAL_RADIUS
    radius, angle = near + (far - near) * radius, 2 * math.pi * direction
    return radius * functions.cos(angle), radius * functions.sin(angle)
