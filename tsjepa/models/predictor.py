"""The predictor: where an embedding goes under a command, and its auto-regressive roll-out (paper eq. eq_pred5)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.support.checks import at_least


class Predictor(nn.Module):
    """One step of embedding dynamics: a residual MLP conditioned on the command, brought back to unit length.

    The command is z-scored with statistics of the training data that are saved with the weights. The paper does not say
    whether the MLP outputs the next embedding or its change; at 20 ms embeddings move little, so ``residual`` learns
    faster.

    Args:
        embedding_dim: d.
        hidden_dim: width of the hidden layer (1024 in the paper).
        residual: output the change of the embedding instead of the embedding.
        action_dim: m, numbers in a command.
    """

    def __init__(
        self, embedding_dim: int = 256, hidden_dim: int = 1024, residual: bool = True, action_dim: int = 1
    ) -> None:
        super().__init__()
        at_least(1, embedding_dim=embedding_dim, hidden_dim=hidden_dim, action_dim=action_dim)
        self.embedding_dim, self.hidden_dim, self.residual = embedding_dim, hidden_dim, residual
        self.action_dim = action_dim
        self.scale = embedding_dim**0.5
        self.hidden = nn.Linear(embedding_dim + action_dim, hidden_dim)
        self.output = nn.Linear(hidden_dim, embedding_dim)
        self.register_buffer("command_mean", torch.zeros(action_dim))
        self.register_buffer("command_std", torch.ones(action_dim))

    def forward(self, embedding: Tensor, command: Tensor) -> Tensor:
        """Next embedding [..., d] of unit length from ``embedding`` [..., d] and ``command`` [..., m] in its units."""
        command = (command - self.command_mean) / self.command_std
        # unit-length embeddings have entries of 1/sqrt(d); the MLP wants them of order one
        hidden = F.relu(self.hidden(torch.cat((embedding * self.scale, command), dim=-1)))
        change = self.output(hidden).float()
        return F.normalize(embedding * self.scale + change if self.residual else change, dim=-1)


def rollout(predictor: nn.Module, embedding: Tensor, commands: Tensor) -> Tensor:
    """Feeds the predictor its own output; the one roll-out used by the loss, the estimator and the evaluation.

    Args:
        predictor: maps (embedding [..., d], command [..., m]) to the next embedding [..., d]; one with a method
            ``ahead``, which gives what is returned here, rolls out in its own way.
        embedding: start [..., d].
        commands: [..., K, m], the command applied in each of K slots.

    Returns:
        Embeddings after each slot, [..., K, d].
    """
    if hasattr(predictor, "ahead"):
        return predictor.ahead(embedding, commands)
    predictions = []
    for command in commands.unbind(dim=-2):
        embedding = predictor(embedding, command)
        predictions.append(embedding)
    return torch.stack(predictions, dim=-2)
