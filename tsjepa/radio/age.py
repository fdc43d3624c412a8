"""Age of information: how it grows, and its long-run mean under the schedulers that have a closed form.

Throughout, the age is 1 in the slot of a delivery, devices are symmetric, slots independent with success probability p.
"""

import numpy as np
import torch
from scipy.stats import binom
from torch import Tensor


def next_age(age: Tensor, refreshed: Tensor) -> Tensor:
    """Age in this slot from the age in the one before: 1 where ``refreshed``, else one more. Same shapes."""
    return torch.where(refreshed, torch.ones_like(age), age + 1)


def mean_age_round_robin(num_devices: int, resource_blocks: int, success: float) -> float:
    """T (2 - p) / (2 p) + 1/2 with the period T = I / J, which must be an integer."""
    _check(num_devices, resource_blocks, success)
    if num_devices % resource_blocks:
        raise ValueError(f"the closed form needs J to divide I, got I = {num_devices}, J = {resource_blocks}")
    period = num_devices // resource_blocks
    return period * (2 - success) / (2 * success) + 0.5


def mean_age_random(num_devices: int, resource_blocks: int, success: float) -> float:
    """I / (J p): J of the I devices drawn afresh in every slot."""
    _check(num_devices, resource_blocks, success)
    return num_devices / (resource_blocks * success)


def mean_deliveries(num_devices: int, resource_blocks: int, success: float) -> float:
    """m = E[min(J, Bin(I, p))]: deliveries per slot when J devices are picked among those that would succeed."""
    _check(num_devices, resource_blocks, success)
    n = np.arange(num_devices + 1)
    return float(np.minimum(resource_blocks, n) @ binom.pmf(n, num_devices, success))


def mean_age_opportunistic(num_devices: int, resource_blocks: int, success: float) -> float:
    """I / m: the J best channels of symmetric devices."""
    return num_devices / mean_deliveries(num_devices, resource_blocks, success)


def mean_age_lower_bound(num_devices: int, resource_blocks: int, success: float) -> float:
    """(I / m + 1) / 2: no scheduler that sees the channel does better."""
    return (mean_age_opportunistic(num_devices, resource_blocks, success) + 1) / 2


def whittle_index(age: Tensor, success: Tensor | float, weight: Tensor | float = 1.0) -> Tensor:
    """Whittle index of a device of age h whose cost is a h (Kadota et al., 2018): (a p h / 2)(h + (2 - p) / p).

    Multiplied out, so that p = 0 is no division by zero. Shapes broadcast.
    """
    age = age.to(success.dtype) if isinstance(success, Tensor) else age.to(torch.get_default_dtype())
    return weight * age / 2 * (success * age + 2 - success)


def _check(num_devices: int, resource_blocks: int, success: float) -> None:
    if not 1 <= resource_blocks <= num_devices:
        raise ValueError(f"need 1 <= J <= I, got I = {num_devices}, J = {resource_blocks}")
    if not 0 < success <= 1:
        raise ValueError(f"success probability {success:g} must lie in (0, 1]")
