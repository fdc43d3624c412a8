"""Schedulers: pure functions that decide who transmits in a slot.

Every scheduler has the signature

    scheduler(age, channel, demand, budget, memory) -> (schedule, memory)

with I devices on the last dimension and any batch shape before it:

    age      [..., I]  slots since the last delivery, counted before this slot (1 = delivered in the slot before)
    channel  ChannelKnowledge, what the base station knows of each link
    demand   [..., I]  int64 resource units that each device needs, or None: one each
    budget   int or [...]  resource units in the slot
    memory   [..., I]  float64, zeros at first, whatever the scheduler wants back next slot; it outlives the episodes
    schedule [..., I]  bool

A scheduler is usually a score handed to :func:`grant`; ties go to the device with the lower index.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tsjepa.radio.age import whittle_index
from tsjepa.radio.streams import uniform


class ChannelKnowledge(NamedTuple):
    """What the base station knows of each link in this slot; all of shape [..., I].

    Attributes:
        snr: linear SNR as known (this slot's, an older slot's, or the mean).
        success: probability that a transmission arrives, given that knowledge.
        above_threshold: whether the known SNR reaches the threshold (the paper's constraint gamma >= gamma_th).
        candidate: devices that may be scheduled at all.
    """

    snr: Tensor
    success: Tensor
    above_threshold: Tensor
    candidate: Tensor


SchedulerFunction = Callable[[Tensor, ChannelKnowledge, Tensor | None, int | Tensor, Tensor], tuple[Tensor, Tensor]]


def grant(score: Tensor, candidate: Tensor, demand: Tensor | None, budget: int | Tensor) -> Tensor:
    """Fill the budget with candidates in order of descending score; equal scores go in order of index.

    Filling stops at the first device that does not fit: nobody with a lower score overtakes it. A device that needs
    more than the whole budget is no candidate. With ``demand=None`` every device takes one unit.

    Args:
        score: [..., I], any real dtype.
        candidate: [..., I] bool.
        demand: [..., I] int64, or None.
        budget: int, or [...] int64.

    Returns:
        [..., I] bool.
    """
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


def round_robin(age, channel, demand, budget, memory):
    """Fixed cyclic order (the paper's baseline 4), blind to the channel. ``memory`` counts a device's grants."""
    num_devices = memory.shape[-1]
    ticket = memory * num_devices + torch.arange(num_devices, device=memory.device)
    schedule = grant(-ticket, channel.candidate, demand, budget)
    return schedule, memory + schedule


def random(age, channel, demand, budget, memory, *, seed: int = 0):
    """A fresh random order in every slot. ``memory`` counts the slots."""
    device = torch.arange(memory.numel(), device=memory.device).view_as(memory)
    score = uniform(seed, "scheduler", device, memory.to(torch.int64))
    return grant(score, channel.candidate, demand, budget), memory + 1


def opportunistic(age, channel, demand, budget, memory):
    """Best channel first (the paper's baseline 5)."""
    return grant(channel.snr, channel.candidate, demand, budget), memory


def max_age(age, channel, demand, budget, memory):
    """Oldest information first, blind to the channel."""
    return grant(age, channel.candidate, demand, budget), memory


def max_weight(age, channel, demand, budget, memory):
    """Largest expected drop of the squared age: p h (h + 2), the quadratic Lyapunov drift (Kadota et al., 2018)."""
    age = age.to(channel.success.dtype)
    return grant(channel.success * age * (age + 2), channel.candidate, demand, budget), memory


def whittle(age, channel, demand, budget, memory):
    """Largest Whittle index of the age first; a device that cannot succeed is left out."""
    score = whittle_index(age, channel.success)
    return grant(score, channel.candidate & (channel.success > 0), demand, budget), memory


def proportional_fair(age, channel, demand, budget, memory, *, horizon: float = 100.0):
    """Largest rate relative to the device's own mean rate. ``memory`` is that mean over about ``horizon`` slots."""
    rate = torch.log2(1.0 + channel.snr)
    schedule = grant(rate / memory.clamp(min=1e-9), channel.candidate, demand, budget)
    return schedule, memory + (rate * schedule - memory) / horizon


def channel_aware(
    age,
    channel,
    demand,
    budget,
    memory,
    *,
    success_weight: float = 1.0,
    age_weight: float = 1.0,
    aoi_reset: str = "delivery",
    snr_gate: bool = True,
):
    """Top marginal gain of the paper's objective sum_i w1 P[success] - w2 log(age), over devices above the threshold.

    Scheduling device i changes the objective by (1 - eps)(w1 + w2 log(1 + beta)) where the age resets on delivery, and
    by w1 (1 - eps) + w2 log(1 + beta) where it resets on scheduling; beta is the age before the slot. The sum is
    separable, so the top J by this gain solve the paper's problem exactly.

    Args:
        success_weight, age_weight: w1 and w2.
        aoi_reset: "delivery" or "scheduled".
        snr_gate: keep the constraint gamma >= gamma_th.
    """
    freshness = age_weight * torch.log1p(age.to(channel.success.dtype))
    if aoi_reset == "delivery":
        score = channel.success * (success_weight + freshness)
    elif aoi_reset == "scheduled":
        score = success_weight * channel.success + freshness
    else:
        raise ValueError(f"unknown aoi_reset {aoi_reset!r}: choose 'delivery' or 'scheduled'")
    return grant(score, _gate(channel, snr_gate), demand, budget), memory


def channel_aware_literal(
    age,
    channel,
    demand,
    budget,
    memory,
    *,
    success_weight: float = 1.0,
    age_weight: float = 1.0,
    snr_gate: bool = True,
):
    """The score as printed, w1 (1 - eps) - w2 log(beta), sorted descending: it serves the freshest devices first.

    beta is the updated age of a device that is not scheduled (the algorithm evaluates it before any alpha is set).
    Kept to show the failure.
    """
    score = success_weight * channel.success - age_weight * torch.log1p(age.to(channel.success.dtype))
    return grant(score, _gate(channel, snr_gate), demand, budget), memory


def oracle(age, channel, demand, budget, memory):
    """Everybody in every slot, whatever the budget: with a lossless uplink, perfect feedback."""
    return channel.candidate.clone(), memory


def none(age, channel, demand, budget, memory):
    """Nobody, ever."""
    return torch.zeros_like(channel.candidate), memory


def gated(scheduler: SchedulerFunction) -> SchedulerFunction:
    """The same scheduler, allowed to pick only devices whose known SNR reaches the threshold."""

    def gated_scheduler(age, channel, demand, budget, memory):
        channel = channel._replace(candidate=channel.candidate & channel.above_threshold)
        return scheduler(age, channel, demand, budget, memory)

    return gated_scheduler


SCHEDULERS: dict[str, SchedulerFunction] = {
    f.__name__: f
    for f in (
        round_robin,
        opportunistic,
        channel_aware,
        channel_aware_literal,
        random,
        max_age,
        max_weight,
        whittle,
        proportional_fair,
        oracle,
        none,
    )
}


def get_scheduler(scheduler: str | SchedulerFunction) -> SchedulerFunction:
    """A built-in scheduler by name; a function is passed through."""
    if callable(scheduler):
        return scheduler
    if scheduler not in SCHEDULERS:
        raise ValueError(f"unknown scheduler {scheduler!r}: choose one of {', '.join(SCHEDULERS)}, or pass a function")
    return SCHEDULERS[scheduler]


def _gate(channel: ChannelKnowledge, snr_gate: bool) -> Tensor:
    return channel.candidate & channel.above_threshold if snr_gate else channel.candidate


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
