"""The semantic actor: an embedding, received or predicted, to a command (paper, section "Semantic actor model")."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from tsjepa.support.checks import at_least, within


class Actor(nn.Module):
    """MLP with two hidden layers on the embedding and, where the plant has set-points, on them too.

    Args:
        action_low, action_high: range of the command [m], in its unit.
        embedding_dim: d.
        hidden_dims: widths of the hidden layers (1024 and 256 in the paper).
        dropout: probability of dropping a hidden unit while training (0.2 in the paper).
        reference_low, reference_high: range of the set-points [r]; empty for an actor that is given none.
    """

    def __init__(
        self,
        action_low: Sequence[float],
        action_high: Sequence[float],
        embedding_dim: int = 256,
        hidden_dims: Sequence[int] = (1024, 256),
        dropout: float = 0.2,
        reference_low: Sequence[float] = (),
        reference_high: Sequence[float] = (),
    ) -> None:
        super().__init__()
        at_least(1, embedding_dim=embedding_dim, **{f"hidden_dims[{i}]": width for i, width in enumerate(hidden_dims)})
        within(0, 1, dropout=dropout)
        self.action_low, self.action_high = tuple(action_low), tuple(action_high)
        self.reference_low, self.reference_high = tuple(reference_low), tuple(reference_high)
        self.embedding_dim, self.hidden_dims, self.dropout = embedding_dim, tuple(hidden_dims), dropout
        first, second = hidden_dims
        self.scale = embedding_dim**0.5
        self.layers = nn.Sequential(
            nn.Linear(embedding_dim + len(self.reference_low), first),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(first, second),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(second, len(self.action_low)),
        )
        for name in ("action", "reference"):
            low, high = (torch.tensor(getattr(self, f"{name}_{end}"), dtype=torch.float32) for end in ("low", "high"))
            self.register_buffer(f"{name}_centre", (low + high) / 2, persistent=False)
            self.register_buffer(f"{name}_half_range", (high - low) / 2, persistent=False)

    def forward(self, embedding: Tensor, reference: Tensor | None = None) -> Tensor:
        """Command [..., m] within the actuator's range.

        Args:
            embedding: [..., d] of unit length.
            reference: set-points [..., r], for an actor that was made with their range; others take no notice of it.

        Raises:
            ValueError: the actor needs set-points and is given none, or as many as it does not take.
        """
        command = self.unclipped(embedding, reference)
        low = self.action_centre - self.action_half_range
        return torch.maximum(torch.minimum(command, self.action_centre + self.action_half_range), low)

    def unclipped(self, embedding: Tensor, reference: Tensor | None = None) -> Tensor:
        """The output before the actuator's limit, so that its gradient never vanishes in training."""
        inputs = embedding * self.scale
        if wanted := len(self.reference_low):
            if reference is None or reference.shape[-1] != wanted:
                given = "none" if reference is None else f"{reference.shape[-1]}"
                raise ValueError(f"This actor takes {wanted} set-points beside the embedding, and was given {given}.")
            scaled = (reference - self.reference_centre) / self.reference_half_range
            inputs = torch.cat((inputs, scaled.expand(*inputs.shape[:-1], wanted)), dim=-1)
        return self.action_centre + self.action_half_range * self.layers(inputs)
