"""The state probe: reads the true state back from a frozen embedding, to see inside; the controller never uses it."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class StateProbe(nn.Module):
    """Small MLP from an embedding [..., d] to the state [..., 4] (m, rad, m/s, rad/s).

    Args:
        embedding_dim: d.
        hidden_dim: width of the two hidden layers.
    """

    def __init__(self, embedding_dim: int = 256, hidden_dim: int = 256) -> None:
        super().__init__()
        self.scale = embedding_dim**0.5
        self.layers = nn.Sequential(
            nn.Linear(embedding_dim, hidden_dim),
            nn.ReLU(),
            nn.Linear(hidden_dim, hidden_dim),
            nn.ReLU(),
            nn.Linear(hidden_dim, 4),
        )
        self.register_buffer("state_mean", torch.zeros(4))
        self.register_buffer("state_std", torch.ones(4))

    def forward(self, embedding: Tensor) -> Tensor:
        return self.layers(embedding * self.scale).float() * self.state_std + self.state_mean
