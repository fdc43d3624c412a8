"""What it costs a plant that its controller knows its state only as it was some slots ago.

A controller that predicts a linear plant x' = A x + B u + w without an update for h slots errs by a covariance of
sum_{k < h} A^k W A^kT. Weighed with a matrix P, such as the solution of the Riccati equation, its trace is the plant's
own cost of age, in the units of the quadratic cost that P belongs to.
"""

from collections.abc import Callable

import torch
from torch import Tensor


def age_cost_table(transition: Tensor, value: Tensor, noise: Tensor, max_age: int) -> Tensor:
    """tr(P sum_{k < h} A^k W A^kT) for the ages h = 0 to ``max_age``.

    Args:
        transition: A [..., n, n], of one slot; one for all devices, or [I, n, n].
        value: P, symmetric and positive semidefinite.
        noise: W, covariance of what disturbs the state in a slot.
        max_age: largest age, at least 1.

    Returns:
        [..., max_age + 1] float64, ascending from 0.

    Raises:
        ValueError: the matrices do not fit each other, or the cost at ``max_age`` is not finite any more.
    """
    a, p, w = (torch.as_tensor(x, dtype=torch.float64) for x in (transition, value, noise))
    if max_age < 1:
        raise ValueError(f"max_age {max_age} must be at least 1 slot")
    if not a.shape[-2:] == p.shape[-2:] == w.shape[-2:] or a.shape[-1] != a.shape[-2]:
        raise ValueError(f"A {tuple(a.shape)}, P {tuple(p.shape)} and W {tuple(w.shape)} must be square and alike")
    costs = [torch.zeros(torch.broadcast_shapes(a.shape[:-2], p.shape[:-2], w.shape[:-2]), dtype=torch.float64)]
    for _ in range(max_age):
        costs.append(costs[-1] + (p * w.mT).sum((-2, -1)))
        w = a @ w @ a.mT
    table = torch.stack(costs, -1)
    if not bool(table.isfinite().all()):
        raise ValueError(f"the plant's cost at an age of {max_age} slots exceeds all numbers: give a smaller max_age")
    return table


def surviving_cost_table(
    transition: Tensor,
    value: Tensor,
    noise: Tensor,
    start: Tensor,
    failed: Callable[[Tensor], Tensor],
    max_age: int,
) -> Tensor:
    """The same, of errors that begin as ``start`` and count only as long as the plant has not failed; by drawn noise.

    To hear of a plant that has fallen saves nothing, so its cost shrinks with the share of the plants that are left.

    Args:
        transition, value, noise, max_age: as of :func:`age_cost_table`.
        start: [..., N, n] errors at age 0, N draws.
        failed: from errors [..., N, n] to [..., N] bool, as of a plant whose state should be 0.

    Returns:
        [..., max_age + 1] float64.
    """
    a, p, w, error = (torch.as_tensor(x, dtype=torch.float64) for x in (transition, value, noise, start))
    scale, basis = torch.linalg.eigh(w)
    root = basis * scale.clamp(min=0).sqrt().unsqueeze(-2)
    generator = torch.Generator().manual_seed(0)
    left, costs = torch.ones(error.shape[:-1], dtype=torch.bool), []
    for _ in range(max_age + 1):
        left = left & ~torch.as_tensor(failed(error))
        costs.append(torch.where(left, ((error @ p) * error).sum(-1), 0.0).mean(-1))
        drawn = torch.randn(error.shape, generator=generator, dtype=torch.float64)
        error = error @ a.mT + drawn @ root.mT
    return torch.stack(costs, -1)


def age_cost(table: Tensor, ages: Tensor) -> Tensor:
    """Cost at ``ages`` [..., I] from a table [max_age + 1] or [I, max_age + 1], float64; beyond its end, its last."""
    ages = ages.to(torch.int64).clamp(max=table.shape[-1] - 1)
    table = table.to(ages.device)
    if table.ndim == 1:
        return table[ages]
    return table.expand(*ages.shape, table.shape[-1]).gather(-1, ages.unsqueeze(-1)).squeeze(-1)


def cost_weight(table: Tensor, ages: Tensor, demand: Tensor | None = None, growth: str = "linear") -> Tensor:
    """Weight that puts the plant's cost of age in the place of a scheduler's own: their ratio at each age, float64.

    Args:
        table, ages: as of :func:`age_cost`.
        demand: [..., I] resource units, for the weight per unit.
        growth: the scheduler's own cost: "linear" is the age (``whittle``; a cost of a times the age has the weight a),
            "quadratic" is 1 + age (age + 2) (``channel_aware`` with its default weights, whose gain becomes the
            probability of success times the plant's cost), "logarithmic" 1 + log(1 + age) (the same with the paper's
            ``age_growth``).
    """
    known = ages.to(torch.float64)
    own = {
        "linear": ages.clamp(min=1),
        "quadratic": 1 + known * (known + 2),
        "logarithmic": 1 + torch.log1p(known),
    }
    if growth not in own:
        raise ValueError(f"unknown growth {growth!r}: choose one of {', '.join(own)}")
    weight = age_cost(table, ages) / own[growth]
    return weight if demand is None else weight / demand.clamp(min=1)
