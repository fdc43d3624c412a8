"""Packet loss that is not caused by the SNR: independent erasures and Gilbert-Elliott bursts."""

from dataclasses import dataclass

import torch
from torch import Tensor

from tsjepa.radio.streams import uniform


@dataclass(frozen=True)
class IidLoss:
    """Every packet is lost with the same probability, independently."""

    probability: float

    def __post_init__(self):
        _check_probability("loss probability", self.probability)

    @property
    def mean(self) -> float:
        return self.probability

    def start(self, seed: int, device: Tensor, episode: Tensor) -> Tensor:
        return torch.zeros_like(device, dtype=torch.bool)

    def advance(self, bad: Tensor, seed: int, device: Tensor, episode: Tensor, slot: Tensor) -> Tensor:
        return bad

    def loss_probability(self, bad: Tensor) -> Tensor:
        return torch.full(bad.shape, self.probability, device=bad.device)


@dataclass(frozen=True)
class GilbertElliott:
    """Two-state Markov chain per device: packets are lost with one probability in the good state, another in the bad.

    Attributes:
        good_to_bad, bad_to_good: transition probabilities per slot.
        loss_good, loss_bad: loss probability in each state; 0 and 1 give Gilbert's burst erasures.
    """

    good_to_bad: float
    bad_to_good: float
    loss_good: float = 0.0
    loss_bad: float = 1.0

    def __post_init__(self):
        for name in ("good_to_bad", "bad_to_good", "loss_good", "loss_bad"):
            _check_probability(name, getattr(self, name))
        if self.good_to_bad + self.bad_to_good == 0:
            raise ValueError("good_to_bad and bad_to_good are both 0: the chain never moves, use IidLoss")

    @property
    def bad_share(self) -> float:
        """Long-run share of slots in the bad state."""
        return self.good_to_bad / (self.good_to_bad + self.bad_to_good)

    @property
    def mean(self) -> float:
        """Long-run loss probability."""
        return self.bad_share * self.loss_bad + (1 - self.bad_share) * self.loss_good

    def start(self, seed: int, device: Tensor, episode: Tensor) -> Tensor:
        """State before slot 0, drawn from the stationary law."""
        return uniform(seed, "loss", device, episode, torch.full_like(device, -1)) < self.bad_share

    def advance(self, bad: Tensor, seed: int, device: Tensor, episode: Tensor, slot: Tensor) -> Tensor:
        """State in this slot from the state in the one before, bool, same shape."""
        draw = uniform(seed, "loss", device, episode, 2 * slot)
        return torch.where(bad, draw >= self.bad_to_good, draw < self.good_to_bad)

    def loss_probability(self, bad: Tensor) -> Tensor:
        return torch.where(bad, self.loss_bad, self.loss_good).to(torch.float32)


def erased(probability: Tensor, seed: int, device: Tensor, episode: Tensor, slot: Tensor) -> Tensor:
    """Whether a packet sent in this slot is lost, bool, drawn with the given probability."""
    return uniform(seed, "loss", device, episode, 2 * slot + 1) < probability


def _check_probability(name: str, value: float) -> None:
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{name} {value:g} must lie in [0, 1]")
