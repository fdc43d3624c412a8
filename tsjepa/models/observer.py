"""The observer: what a device believes of its machine, from all it has seen instead of its last frames alone."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.support.checks import at_least


class Observer(nn.Module):
    """A Luenberger observer on embeddings, whose gain is learned: what was predicted, corrected by what is seen.

    The belief is x = normalize(p + G (z - p)), with p the predictor's step from the last belief and z the embedding of
    this slot's frames. A stack of two frames tells a rate from the difference of two pictures; G leaves to the
    prediction what a stack tells badly. A steady-state Kalman filter is the same for a linear machine.

    Args:
        embedding_dim: d.
        gain: G before it is trained, times the identity: 1 takes every embedding as it is.
    """

    def __init__(self, embedding_dim: int = 256, gain: float = 0.7) -> None:
        super().__init__()
        at_least(1, embedding_dim=embedding_dim)
        self.embedding_dim, self.gain = embedding_dim, gain
        self.correction = nn.Linear(embedding_dim, embedding_dim, bias=False)
        with torch.no_grad():
            self.correction.weight.copy_(gain * torch.eye(embedding_dim))

    def forward(self, predicted: Tensor, embedding: Tensor) -> Tensor:
        """Belief [..., d] of unit length from ``predicted`` [..., d] and the ``embedding`` [..., d] that is seen."""
        return F.normalize(predicted + self.correction(embedding - predicted).float(), dim=-1)
