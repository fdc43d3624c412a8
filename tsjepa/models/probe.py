"""The state probe: reads the true state back from a frozen embedding, to see inside; the controller never uses it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from tsjepa.support.checks import at_least


class StateProbe(nn.Module):
    """Small MLP from an embedding [..., d] to the state [..., n], in the state's own units.

    Args:
        state_dim: n.
        embedding_dim: d.
        hidden_dim: width of the two hidden layers.
    """

    def __init__(self, state_dim: int, embedding_dim: int = 256, hidden_dim: int = 256) -> None:
        super().__init__()
        at_least(1, state_dim=state_dim, embedding_dim=embedding_dim, hidden_dim=hidden_dim)
        self.state_dim, self.embedding_dim, self.hidden_dim = state_dim, embedding_dim, hidden_dim
        self.scale = embedding_dim**0.5
        self.layers = nn.Sequential(
            nn.Linear(embedding_dim, hidden_dim),
            nn.ReLU(),
            nn.Linear(hidden_dim, hidden_dim),
            nn.ReLU(),
            nn.Linear(hidden_dim, state_dim),
        )
        self.register_buffer("state_mean", torch.zeros(state_dim))
        self.register_buffer("state_std", torch.ones(state_dim))

    def forward(self, embedding: Tensor) -> Tensor:
        return self.layers(embedding * self.scale).float() * self.state_std + self.state_mean
