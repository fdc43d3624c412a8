"""Values of a fleet whose devices are not alike: a list is dealt out to the devices in turn."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def deal(values: float | Sequence[float] | Tensor, count: int) -> Tensor:
    """One value a device, [count, ...] float64: device i has ``values[i % len(values)]``, all have a single number.

    A device keeps its value in a larger fleet.

    Raises:
        ValueError: an empty list.
    """
    dealt = torch.as_tensor(values, dtype=torch.float64)
    if dealt.ndim == 0:
        return dealt.expand(count)
    if not len(dealt):
        raise ValueError("a list of values for the devices is empty: give at least one")
    return dealt[torch.arange(count) % len(dealt)]
