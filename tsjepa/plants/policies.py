"""Experts that somebody else has made: a module, or a file that holds one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn


class Rest(nn.Module):
    """The same command, whatever the state.

    Args:
        command: [m], such as the one nearest to zero, :attr:`tsjepa.support.spec.PlantSpec.rest`.
    """

    def __init__(self, command: Sequence[float]) -> None:
        super().__init__()
        self.register_buffer("command", torch.tensor(command))

    def forward(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        """Command [..., m] for states [..., n]."""
        return self.command.to(state).expand(*state.shape[:-1], -1)


class Policy(nn.Module):
    """A module from states [N, n] to commands [N, m] as an expert: any batch shape, within the actuator's range.

    Args:
        module: called with the states in float32.
        action_low, action_high: range of the command [m].
    """

    def __init__(self, module: nn.Module, action_low: Sequence[float], action_high: Sequence[float]) -> None:
        super().__init__()
        self.module = module
        self.register_buffer("low", torch.tensor(action_low))
        self.register_buffer("high", torch.tensor(action_high))

    @torch.no_grad()
    def forward(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        """Command [..., m] for states [..., n].

        Raises:
            ValueError: the module gives something else than one command for each state.
        """
        command = self.module(state.reshape(-1, state.shape[-1]).float())
        wanted = (state[..., 0].numel(), len(self.low))
        if tuple(command.shape) != wanted:
            raise ValueError(f"The policy gave {list(command.shape)} for {wanted[0]} states and {wanted[1]} commands.")
        return command.clamp(self.low, self.high).to(state.dtype).reshape(*state.shape[:-1], -1)


def load_policy(expert: nn.Module | str | os.PathLike, low: Sequence[float], high: Sequence[float]) -> Policy:
    """An expert from a module, or from a file of ``torch.export.save`` (.pt2) or ``torch.jit.save``.

    Such a file is a program: take it from somebody whom you trust.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it holds no policy.
    """
    if isinstance(expert, nn.Module):
        return Policy(expert, low, high)
    path = Path(expert)
    if not path.is_file():
        raise FileNotFoundError(f"There is no policy {path}.")
    try:
        module = torch.export.load(path).module() if path.suffix == ".pt2" else torch.jit.load(path).eval()
    except Exception as error:
        raise ValueError(
            f"{path} is no policy: save one by torch.jit.save, or by torch.export.save with the ending .pt2."
        ) from error
    return Policy(module, low, high)
