"""Who is granted a slot's budget, given a score of each device."""

import numpy as np
import torch
from torch import Tensor


def grant(score: Tensor, candidate: Tensor, demand: Tensor | None, budget: int | Tensor) -> Tensor:
    """Fill the budget with candidates in order of descending score; equal scores go in order of index.

    Filling stops at the first device that does not fit: nobody with a lower score overtakes it. A device that needs
    more than the whole budget, or whose score is not a number, is no candidate. With ``demand=None`` every device takes
    one unit.

    Args:
        score: [..., I], any real dtype.
        candidate: [..., I] bool.
        demand: [..., I] int64, or None.
        budget: int, or [...] int64.

    Returns:
        [..., I] bool.
    """
    candidate = candidate & (score == score)  # NaN is not equal to itself
    if demand is None and isinstance(budget, int):
        return _top(score, candidate, budget)
    room = torch.as_tensor(budget, device=score.device).unsqueeze(-1)
    demand = torch.ones_like(candidate, dtype=torch.int64) if demand is None else demand
    candidate = candidate & (demand <= room)
    # non-candidates are sorted last, where their demand no longer matters
    order = torch.where(candidate, _to_float(score), -torch.inf).sort(dim=-1, descending=True, stable=True).indices
    used = demand.masked_fill(~candidate, 0).gather(-1, order).cumsum(-1)
    fits = (used <= room).cummin(-1).values
    return torch.zeros_like(candidate).scatter(-1, order, fits) & candidate


def _top(score: Tensor, candidate: Tensor, count: int) -> Tensor:
    """The ``count`` best candidates by a threshold instead of a sort: linear in I."""
    if count <= 0:
        return torch.zeros_like(candidate)
    if count >= score.shape[-1]:
        return candidate.clone()
    score = torch.where(candidate, _to_float(score), -torch.inf)
    threshold = _kth_largest(score, count)
    ahead = score > threshold
    tied = (score == threshold) & candidate
    vacant = count - ahead.sum(-1, keepdim=True, dtype=torch.int32)
    return ahead | (tied & (tied.cumsum(-1, dtype=torch.int32) <= vacant))


def _kth_largest(score: Tensor, k: int) -> Tensor:
    """k-th largest score of each row, [..., 1]."""
    if score.device.type != "cpu":
        return score.topk(k, dim=-1, sorted=False).values.amin(-1, keepdim=True)
    # numpy's vectorised quickselect is several times faster than torch.topk on a CPU
    position = score.shape[-1] - k
    return torch.from_numpy(np.partition(score.detach().numpy(), position, axis=-1)[..., position : position + 1])


def _to_float(score: Tensor) -> Tensor:
    # integer scores such as ages stay exact up to 2^53
    return score if score.is_floating_point() else score.to(torch.float64)
