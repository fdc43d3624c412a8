"""Loss terms over unit-length embeddings."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F


@dataclass
class LossTerm:
    """A term that a recipe adds to TS-JEPA's loss.

    Args:
        function: from the context embeddings [B, W, d], the target embeddings [B, W, d] and the commands between them
            [B, W - 1, gap, m] to a scalar; named by its import path.
        weight: by which it is multiplied.

    Raises:
        ValueError: the function does not take three arguments.
    """

    function: Callable[[Tensor, Tensor, Tensor], Any]  # the parser refuses one without annotations where it is Tensor
    weight: float = 1.0

    def __post_init__(self) -> None:
        try:
            signature = inspect.signature(self.function)
        except (TypeError, ValueError):  # of a function that is not written in Python
            return
        try:
            signature.bind(None, None, None)
        except TypeError as error:
            raise ValueError(
                f"The loss term {self.path} takes {signature}; it is called with the context embeddings, the target "
                "embeddings and the commands."
            ) from error

    @property
    def path(self) -> str:
        """Where the function is, for messages."""
        kind = self.function if hasattr(self.function, "__qualname__") else type(self.function)
        return f"{kind.__module__}.{kind.__qualname__}"

    def __call__(self, embedding: Tensor, target: Tensor, commands: Tensor) -> Tensor | float:
        """The term's value.

        Raises:
            ValueError: it is no scalar, or it is not finite though the embeddings are.
        """
        value = self.function(embedding, target, commands)
        if not isinstance(value, (int, float)) and not (isinstance(value, Tensor) and value.ndim == 0):
            given = f"a tensor of shape {list(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
            raise ValueError(
                f"The loss term {self.path} gives {given}; it has to give a scalar, such as the mean of it all."
            )
        number = float(value.detach() if isinstance(value, Tensor) else value)
        if not math.isfinite(number) and bool(embedding.isfinite().all()):
            raise ValueError(
                f"The loss term {self.path} is {number} though all embeddings are finite: it divides by zero, or "
                "takes a root or logarithm of what is not positive."
            )
        return value


def cosine_loss(prediction: Tensor, target: Tensor) -> Tensor:
    """Mean of 1 - cosine similarity over all leading dimensions (paper eq. eq_opt_problem with the sign put right)."""
    return 1 - F.cosine_similarity(prediction, target, dim=-1).mean()


def variance_loss(embedding: Tensor) -> Tensor:
    """Hinge on each dimension's standard deviation over ``embedding`` [N, d]; isotropy has one (VICReg)."""
    scaled = embedding * embedding.shape[-1] ** 0.5
    return F.relu(1 - (scaled.var(0) + 1e-4).sqrt()).mean()


def covariance_loss(embedding: Tensor) -> Tensor:
    """Squared off-diagonal covariances of ``embedding`` [N, d], summed over d; scaled as the variance (VICReg)."""
    count, dimension = embedding.shape
    centred = (embedding - embedding.mean(0)) * dimension**0.5
    covariance = centred.T @ centred / (count - 1)
    return (covariance.square().sum() - covariance.diagonal().square().sum()) / dimension


class InverseDynamics(nn.Module):
    """Recovers the command between two embeddings; needs no label but the command that was sent.

    What it asks of the embedding is exactly the velocity, which a frame pair carries only in tenths of a pixel.

    Args:
        embedding_dim: d.
        action_dim: m.
        hidden_dim: width of the hidden layer.
    """

    def __init__(self, embedding_dim: int, action_dim: int = 1, hidden_dim: int = 256) -> None:
        super().__init__()
        self.scale = embedding_dim**0.5
        self.layers = nn.Sequential(
            nn.Linear(2 * embedding_dim + 1, hidden_dim), nn.ReLU(), nn.Linear(hidden_dim, action_dim)
        )

    def forward(self, before: Tensor, after: Tensor, gap: int) -> Tensor:
        """Mean z-scored command [..., m] over the ``gap`` slots between ``before`` and ``after`` [..., d]."""
        gaps = torch.full_like(before[..., :1], gap / 4)
        return self.layers(torch.cat((before * self.scale, (after - before) * self.scale, gaps), dim=-1)).float()
