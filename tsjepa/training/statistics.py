"""Means and standard deviations by which targets and commands are scaled."""

from __future__ import annotations

from torch import Tensor


def mean_and_std(values: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation over the first dimension of ``values`` [N, ...].

    What does not vary gets a standard deviation of 1, so that scaling leaves a zero there and not a division by zero.
    """
    std = values.std(0)
    return values.mean(0), std.where(std > 0, 1.0)
