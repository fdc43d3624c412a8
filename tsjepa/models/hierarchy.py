"""Prediction at several strides: one jump over many slots instead of many steps of one (as in H-JEPA)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from tsjepa.models.predictor import Predictor
from tsjepa.support.checks import at_least


class HierarchicalPredictor(nn.Module):
    """A predictor for each stride, from an embedding and the chunk of commands in it to the embedding after it.

    An age is covered by the largest strides first, and what they leave by the smaller ones: 48 slots by strides of 20,
    5 and 1 are 20, 20, 5, 1, 1, 1. Each new slot then costs one jump: see :meth:`advance`.

    Commands are z-scored by statistics that are saved with the weights. As a function of one embedding and one command
    it is the predictor of one slot.

    Args:
        embedding_dim: d.
        widths: width of the hidden layer of each stride's predictor.
        strides: slots of a jump, ascending from 1, each a multiple of the one before.
        action_dim: m, numbers in a command.

    Raises:
        ValueError: strides of another kind, or not a width for each.
    """

    def __init__(
        self,
        embedding_dim: int = 256,
        widths: Sequence[int] = (512, 512, 512),
        strides: Sequence[int] = (1, 5, 20),
        action_dim: int = 1,
    ) -> None:
        super().__init__()
        at_least(1, action_dim=action_dim, **{f"strides[{index}]": stride for index, stride in enumerate(strides)})
        steps = list(itertools.pairwise(strides))
        if not strides or strides[0] != 1 or any(large <= small or large % small for small, large in steps):
            raise ValueError(
                f"strides {list(strides)} must ascend from 1, each a multiple of the one before, such as [1, 5, 20]."
            )
        if len(widths) != len(strides):
            raise ValueError(f"widths has {len(widths)} numbers for {len(strides)} strides; give one for each.")
        self.embedding_dim, self.widths, self.action_dim = embedding_dim, tuple(widths), action_dim
        self.strides = tuple(strides)
        self.levels = nn.ModuleList(
            Predictor(embedding_dim, hidden_dim, action_dim=stride * action_dim)
            for stride, hidden_dim in zip(strides, widths, strict=True)
        )
        self.register_buffer("command_mean", torch.zeros(action_dim))
        self.register_buffer("command_std", torch.ones(action_dim))

    def forward(self, embedding: Tensor, command: Tensor) -> Tensor:
        """Embedding [..., d] one slot after ``embedding`` [..., d] under ``command`` [..., m] in its units."""
        return self.jump(0, embedding, command.unsqueeze(-2))

    def jump(self, level: int, embedding: Tensor, commands: Tensor) -> Tensor:
        """Embedding [..., d] a stride after ``embedding`` [..., d] under the stride's ``commands`` [..., stride, m]."""
        commands = (commands - self.command_mean) / self.command_std
        return self.levels[level](embedding, commands.flatten(-2))

    def jumps(self, level: int, embedding: Tensor, commands: Tensor) -> Tensor:
        """Embeddings [..., K, d] after each of K jumps under ``commands`` [..., K * stride, m]."""
        predictions = []
        for chunk in commands.unflatten(-2, (-1, self.strides[level])).unbind(-3):
            embedding = self.jump(level, embedding, chunk)
            predictions.append(embedding)
        return torch.stack(predictions, -2)

    def ahead(self, embedding: Tensor, commands: Tensor) -> Tensor:
        """Embeddings [..., K, d] after each of K slots under ``commands`` [..., K, m], by the largest strides first."""
        trail, predictions = [embedding] * len(self.strides), []
        for slots in range(1, commands.shape[-2] + 1):
            level = self.level_of(slots)
            start = slots - self.strides[level]
            reached = self.jump(level, trail[level], commands[..., start:slots, :])
            trail = [reached if finer <= level else place for finer, place in enumerate(trail)]
            predictions.append(reached)
        return torch.stack(predictions, -2)

    def level_of(self, slots: int) -> int:
        """The largest stride, by its place in ``strides``, that ends after ``slots`` slots."""
        return max(level for level, stride in enumerate(self.strides) if slots % stride == 0)

    def advance(self, trail: Tensor, commands: Tensor, slots: Tensor) -> Tensor:
        """The trail one slot later, for rows of any ages.

        Args:
            trail: [..., strides, d], where each stride's last jump has ended; the first is the newest prediction.
            commands: [..., largest stride, m], those of the last slots, newest last.
            slots: [...], age of the received embedding at the end of this slot, from 1.

        Returns:
            [..., strides, d].
        """
        after = trail
        for level, stride in enumerate(self.strides):
            due = slots % stride == 0
            if not bool(due.any()):
                break
            reached = self.jump(level, trail[..., level, :], commands[..., -stride:, :])
            finer = torch.arange(len(self.strides), device=trail.device) <= level
            after = torch.where(due[..., None, None] & finer[:, None], reached.unsqueeze(-2), after)
        return after
