"""Scores of closed loops and their intervals."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from scipy import stats
from torch import Tensor

from tsjepa.support.spec import PlantSpec


@dataclass
class Run:
    """What I devices did in a closed loop over T slots.

    Args:
        spec: of the plant.
        state: [T + 1, I, n], true states, the first before any command.
        action: [T, I, m], commands that were applied.
        expert_action: [T, I, m], the expert's commands in the same states.
        score: [T, I] in 0..1, the plant's score of the state that each slot ended in, falls not counted.
        failed_now: [T + 1, I] bool, where the plant is beyond recovery.
        scheduled, delivered: [T, I] bool.
        age: [T, I] slots since the last delivery, 1 on delivery.
        payload_bits: [T, I] bits sent.
        used: [T], what was granted of a slot's ``capacity``.
        capacity: what a slot offers, devices or resource units.
        cost: [T, I], the plant's cost of each slot, or None where it has none.
        energy_j: [T, I] joules of each device, or None where they are not counted.
        signalling_bits: [T, I] bits spent to tell how urgent a device is, or None where devices tell nothing.
    """

    spec: PlantSpec
    state: Tensor
    action: Tensor
    expert_action: Tensor
    score: Tensor
    failed_now: Tensor
    scheduled: Tensor
    delivered: Tensor
    age: Tensor
    payload_bits: Tensor
    used: Tensor
    capacity: int
    cost: Tensor | None = None
    energy_j: Tensor | None = None
    signalling_bits: Tensor | None = None

    def slot_score(self) -> Tensor:
        """[T, I]: the score of each slot; nothing counts from a failure on."""
        fallen = self.failed_now[1:].cummax(0).values | self.failed_now[0]
        return self.score.masked_fill(fallen, 0.0)

    def raw_score(self) -> Tensor:
        """[I]: mean score over the slots (paper eq. eq5_scoring), 0 from a failure on."""
        return self.slot_score().mean(0)

    def failed(self) -> Tensor:
        """[I] bool: whether the plant failed at any slot."""
        return self.failed_now.any(0)

    def quadratic_cost(self) -> Tensor:
        """[I]: the plant's cost summed over the slots (paper eq. eq5_Optimization_prob)."""
        return self.cost.sum(0)

    def command_nmae(self) -> Tensor:
        """[I]: mean distance to the expert's command over the actuator's range (paper eq. eq5_NMAE)."""
        span = torch.tensor(self.spec.action_range)
        return ((self.action - self.expert_action).abs() / span).mean((0, 2))

    def delivery_rate(self) -> float:
        """Share of the transmissions that arrive; 0 where nobody transmits."""
        return float(self.delivered.sum() / self.scheduled.sum().clamp(min=1))

    def utilisation(self) -> float:
        """Share of the radio that was granted."""
        return float(self.used.float().mean() / self.capacity)


def normalized_score(raw: Tensor, optimal: Tensor) -> float:
    """Sum of raw scores over the sum of the normaliser's on the same starts.

    Raises:
        ValueError: the normaliser scores nothing, so that there is nothing to divide by.
    """
    if not float(optimal.sum()) > 0:
        raise ValueError(
            "With perfect feedback the normaliser scores nothing on these starts, so that scores cannot be "
            "normalised; take more slots or more starts."
        )
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
