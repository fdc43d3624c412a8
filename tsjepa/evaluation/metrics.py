"""The paper's scores and their intervals."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from scipy import stats
from torch import Tensor

from tsjepa.plants.score import has_failed, in_box

COMMAND_RANGE = 40.0  # newtons, max(u) - min(u) of the actuator (paper-notes, decision 24)
EFFORT_WEIGHT = 1e-3  # R of the quadratic cost (decision 17)


@dataclass
class Run:
    """Closed loops of N starts over T slots.

    Args:
        state: [T + 1, N, 4], true states, the first before any command.
        action: [T, N, 1] applied commands in newtons.
        expert_action: [T, N, 1], the expert's command in the same states.
    """

    state: Tensor
    action: Tensor
    expert_action: Tensor

    def in_box(self) -> Tensor:
        """[T, N] bool: which starts are in the box after each slot."""
        return in_box(self.state[1:])

    def raw_score(self) -> Tensor:
        """[N]: share of slots that end in the box (paper eq. eq5_scoring)."""
        return self.in_box().float().mean(0)

    def failed(self) -> Tensor:
        """[N] bool: the pole fell or the cart left the rail at any slot."""
        return has_failed(self.state).any(0)

    def quadratic_cost(self) -> Tensor:
        """[N]: (1/2) sum |s|^2 + R u^2 (paper eq. eq5_Optimization_prob, R = 1e-3)."""
        return 0.5 * (self.state[1:].square().sum(-1) + EFFORT_WEIGHT * self.action[..., 0].square()).sum(0)

    def command_nmae(self) -> Tensor:
        """[N]: mean distance to the expert's command over 40 N (paper eq. eq5_NMAE)."""
        return (self.action - self.expert_action).abs().mean((0, 2)) / COMMAND_RANGE


def normalized_score(raw: Tensor, optimal: Tensor) -> float:
    """Sum of raw scores over the sum of the optimal policy's on the same starts (paper-notes, decision 17)."""
    return float(raw.sum() / optimal.sum())


def interval(values: list[float]) -> tuple[float, float]:
    """Mean and half-width of its 95 % interval (Student's t) over independent seeds.

    Raises:
        ValueError: fewer than two values.
    """
    if len(values) < 2:
        raise ValueError(f"An interval needs at least 2 seeds, not {len(values)}.")
    data = torch.tensor(values, dtype=torch.float64)
    half = stats.t.ppf(0.975, len(values) - 1) * data.std() / len(values) ** 0.5
    return float(data.mean()), float(half)
