"""The observer: what a device believes of its machine, from more than its last frames alone."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.support.checks import at_least


class Observer(nn.Module):
    """A Luenberger observer on embeddings, whose gain is learned: what was predicted, corrected by what is seen.

    The belief is x = normalize(p + G (z - e)), with p the predictor's step from the last belief, z the embedding of
    this slot's frames and e what is expected to be seen. A stack of two frames tells a rate from the difference of two
    pictures; G leaves to the prediction what a stack tells badly. A steady-state Kalman filter is the same for a
    linear machine.

    Without ``hidden_dim`` e is p. But two frames do not show what the command did since the older one, so that one
    state is seen in many ways. With ``hidden_dim`` a network of one hidden layer tells e from p and that command u:
    e = normalize(p + f(p, u)).

    Args:
        embedding_dim: d.
        gain: G before it is trained, times the identity: 1 takes every embedding as it is.
        hidden_dim: width of that network; None for none.
        memory: False puts z in the place of p: the device remembers nothing but its last command.
        action_dim: m, numbers in a command.

    Raises:
        ValueError: neither a memory nor a network, which would change nothing.
    """

    def __init__(
        self,
        embedding_dim: int = 256,
        gain: float = 0.7,
        hidden_dim: int | None = None,
        memory: bool = True,
        action_dim: int = 1,
    ) -> None:
        super().__init__()
        at_least(1, embedding_dim=embedding_dim, action_dim=action_dim)
        if not memory and hidden_dim is None:
            raise ValueError(
                "An observer without memory corrects by the last command: give it a hidden_dim, such as 512."
            )
        self.embedding_dim, self.gain, self.hidden_dim = embedding_dim, gain, hidden_dim
        self.memory, self.action_dim = memory, action_dim
        self.scale = embedding_dim**0.5
        self.correction = nn.Linear(embedding_dim, embedding_dim, bias=False)
        with torch.no_grad():
            self.correction.weight.copy_(gain * torch.eye(embedding_dim))
        if hidden_dim is not None:
            at_least(1, hidden_dim=hidden_dim)
            self.hidden = nn.Linear(embedding_dim + action_dim, hidden_dim)
            self.shown = nn.Linear(hidden_dim, embedding_dim)
            nn.init.zeros_(self.shown.weight)  # so that it begins as an observer that expects what was predicted
            nn.init.zeros_(self.shown.bias)
            self.register_buffer("command_mean", torch.zeros(action_dim))
            self.register_buffer("command_std", torch.ones(action_dim))

    def forward(self, predicted: Tensor, embedding: Tensor, command: Tensor) -> Tensor:
        """Belief [..., d] of unit length.

        Args:
            predicted: [..., d], which an observer without memory does not read.
            embedding: [..., d], that is seen.
            command: [..., m], applied since the slot before, in its units.
        """
        prior = predicted if self.memory else embedding
        change = self.correction(embedding - self.expected(prior, command))
        return F.normalize(prior + change.float(), dim=-1)

    def expected(self, prior: Tensor, command: Tensor) -> Tensor:
        """What a stack shows [..., d] of a machine as ``prior`` [..., d] has it, after ``command`` [..., m]."""
        if self.hidden_dim is None:
            return prior
        command = (command - self.command_mean) / self.command_std
        hidden = F.relu(self.hidden(torch.cat((prior * self.scale, command), dim=-1)))
        return F.normalize(prior * self.scale + self.shown(hidden).float(), dim=-1)
