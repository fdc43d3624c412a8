"""The semantic actor: an embedding, received or predicted, to a command (paper, section "Semantic actor model")."""

from __future__ import annotations

from torch import Tensor, nn

from tsjepa.support.checks import at_least, within

COMMAND_LIMIT = 20.0  # newtons; u_max = -u_min in the paper


class Actor(nn.Module):
    """MLP with two hidden layers.

    Args:
        embedding_dim: d.
        hidden_dims: widths of the hidden layers (1024 and 256 in the paper).
        dropout: probability of dropping a hidden unit while training (0.2 in the paper).
    """

    def __init__(
        self, embedding_dim: int = 256, hidden_dims: tuple[int, int] = (1024, 256), dropout: float = 0.2
    ) -> None:
        super().__init__()
        at_least(1, embedding_dim=embedding_dim, **{f"hidden_dims[{i}]": width for i, width in enumerate(hidden_dims)})
        within(0, 1, dropout=dropout)
        self.hidden_dims = tuple(hidden_dims)
        first, second = hidden_dims
        self.scale = embedding_dim**0.5
        self.layers = nn.Sequential(
            nn.Linear(embedding_dim, first),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(first, second),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(second, 1),
        )

    def forward(self, embedding: Tensor) -> Tensor:
        """Command [..., 1] in newtons, within +-20, from ``embedding`` [..., d] of unit length."""
        return self.unclipped(embedding).clamp(-COMMAND_LIMIT, COMMAND_LIMIT)

    def unclipped(self, embedding: Tensor) -> Tensor:
        """The output in newtons before the actuator's limit, so that its gradient never vanishes in training."""
        return COMMAND_LIMIT * self.layers(embedding * self.scale)
