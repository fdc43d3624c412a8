"""Where a model computes."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor, nn


def at_weights(model: nn.Module, method: Callable) -> Callable:
    """``method`` of ``model`` for tensors anywhere: computed where its weights lie, and the result brought back."""

    def call(first: Tensor, *others: Tensor | None) -> Tensor:
        weight = next(model.parameters(), first)
        given = (tensor if tensor is None else tensor.to(weight.device) for tensor in (first, *others))
        return method(*given).to(first.device)

    return call
