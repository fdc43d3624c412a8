"""Schedulers: pure functions that decide who transmits in a slot.

Every scheduler has the signature

    scheduler(known: Known) -> (schedule, memory)

with ``schedule`` [..., I] bool and ``memory`` [..., I] float64, whatever the scheduler wants back in the next slot. It
is usually a score handed to :func:`tsjepa.radio.grant.grant`; ties go to the device with the lower index.
"""

import inspect
from collections.abc import Callable
from functools import partial, wraps

import torch
from torch import Tensor

from tsjepa.radio.age import whittle_index
from tsjepa.radio.grant import grant
from tsjepa.radio.knowledge import Known
from tsjepa.radio.need import channel_aware_cost, expected_urgency, first_contact, genie, urgency, whittle_cost
from tsjepa.radio.streams import uniform
from tsjepa.support.description import load_named
from tsjepa.support.nearest import did_you_mean

SchedulerFunction = Callable[[Known], tuple[Tensor, Tensor]]


def round_robin(known: Known):
    """Fixed cyclic order (the paper's baseline 4), blind to the channel. ``memory`` counts a device's grants."""
    num_devices = known.memory.shape[-1]
    ticket = known.memory * num_devices + torch.arange(num_devices, device=known.memory.device)
    schedule = _grant(-ticket, known)
    return schedule, known.memory + schedule


def random(known: Known, *, seed: int = 0):
    """A fresh random order in every slot. ``memory`` counts the slots."""
    device = torch.arange(known.memory.numel(), device=known.memory.device).view_as(known.memory)
    score = uniform(seed, "scheduler", device, known.memory.to(torch.int64))
    return _grant(score, known), known.memory + 1


def opportunistic(known: Known):
    """Best channel first (the paper's baseline 5)."""
    return _grant(known.snr, known), known.memory


def max_age(known: Known):
    """Oldest information first, blind to the channel."""
    return _grant(known.age, known), known.memory


def max_weight(known: Known):
    """Largest expected drop of the squared age: p h (h + 2), the quadratic Lyapunov drift (Kadota et al., 2018)."""
    age = known.age.to(known.success.dtype)
    return _grant(_weighted(known.success * age * (age + 2), known), known), known.memory


def whittle(known: Known):
    """Largest Whittle index of the age first; a device that cannot succeed is left out."""
    score = _weighted(whittle_index(known.age, known.success), known)
    return grant(score, known.candidate & (known.success > 0), known.demand, known.budget), known.memory


def proportional_fair(known: Known, *, horizon: float = 100.0):
    """Largest rate relative to the device's own mean rate. ``memory`` is that mean over about ``horizon`` slots."""
    rate = torch.log2(1.0 + known.snr)
    schedule = _grant(rate / known.memory.clamp(min=1e-9), known)
    return schedule, known.memory + (rate * schedule - known.memory) / horizon


def channel_aware(
    known: Known,
    *,
    success_weight: float = 1.0,
    age_weight: float = 1.0,
    aoi_reset: str = "delivery",
    snr_gate: bool = True,
    age_growth: str = "quadratic",
):
    """Top marginal gain of the objective sum_i w1 P[success] - w2 f(age), over devices above the threshold.

    Scheduling device i changes the objective by (1 - eps)(w1 + w2 g) where the age resets on delivery, and by
    w1 (1 - eps) + w2 g where it resets on scheduling, with g = f(beta + 1) - f(1) and beta the age before the slot. The
    sum is separable, so the top J by this gain solve the problem exactly.

    The paper has f = log. Where all links are believed alike, every growing f ranks the devices alike. Where they are
    not, log gives up a device that is believed to be in a burst of losses, since waiting costs it ever less; a plant
    that falls pays ever more, so f is the square by default.

    Args:
        known: what is known of the slot.
        success_weight, age_weight: w1 and w2.
        aoi_reset: "delivery" or "scheduled".
        snr_gate: keep the constraint gamma >= gamma_th.
        age_growth: f, "quadratic" or (the paper's) "logarithmic".
    """
    age = known.age.to(known.success.dtype)
    if age_growth not in ("quadratic", "logarithmic"):
        raise ValueError(f"unknown age_growth {age_growth!r}: choose 'quadratic' or 'logarithmic'")
    freshness = age_weight * (age * (age + 2) if age_growth == "quadratic" else torch.log1p(age))
    if aoi_reset == "delivery":
        score = known.success * (success_weight + freshness)
    elif aoi_reset == "scheduled":
        score = success_weight * known.success + freshness
    else:
        raise ValueError(f"unknown aoi_reset {aoi_reset!r}: choose 'delivery' or 'scheduled'")
    return grant(_weighted(score, known), _gate(known, snr_gate), known.demand, known.budget), known.memory


def channel_aware_literal(
    known: Known,
    *,
    success_weight: float = 1.0,
    age_weight: float = 1.0,
    snr_gate: bool = True,
):
    """The score as printed, w1 (1 - eps) - w2 log(beta), sorted descending: it serves the freshest devices first.

    beta is the updated age of a device that is not scheduled (the algorithm evaluates it before any alpha is set).
    Kept to show the failure.
    """
    score = success_weight * known.success - age_weight * torch.log1p(known.age.to(known.success.dtype))
    return grant(score, _gate(known, snr_gate), known.demand, known.budget), known.memory


def periodic(period: int) -> SchedulerFunction:
    """A scheduler that serves each device in slot 0 of its episode and every ``period`` slots after it.

    It ignores the channel and the budget. ``period`` 0 serves slot 0 only.
    """
    if period < 0:
        raise ValueError(f"period {period} must be at least 1 slot, or 0 for the first slot of an episode only")

    def periodic_scheduler(known: Known):
        if known.slot is None:
            raise ValueError(
                f"a schedule of period {period} counts the slots of each device's episode, which nobody counts here: "
                "use a plant that writes the key 'slot'"
            )
        due = known.slot % period == 0 if period else known.slot == 0
        return known.candidate & due, known.memory

    periodic_scheduler.__name__ = f"periodic({period})"
    return periodic_scheduler


def once(known: Known):
    """Everybody in the first slot of its episode, whatever the budget, and nobody after it."""
    return periodic(0)(known)


def oracle(known: Known):
    """Everybody in every slot, whatever the budget: with a lossless uplink, perfect feedback."""
    return known.candidate.clone(), known.memory


def none(known: Known):
    """Nobody, ever."""
    return torch.zeros_like(known.candidate), known.memory


def gated(scheduler: str | SchedulerFunction) -> SchedulerFunction:
    """The same scheduler, allowed to pick only devices whose SNR may reach the threshold, given what is known.

    Raises:
        ValueError: see :func:`get_scheduler`.
    """
    scheduler = get_scheduler(scheduler)

    @wraps(scheduler)
    def gated_scheduler(known: Known):
        return scheduler(known._replace(candidate=known.candidate & known.above_threshold))

    gated_scheduler.__name__ = f"gated({name_of(scheduler)})"
    return gated_scheduler


SCHEDULERS: dict[str, Callable[..., tuple[Tensor, Tensor]]] = {
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
        whittle_cost,
        channel_aware_cost,
        urgency,
        first_contact,
        expected_urgency,
        genie,
        proportional_fair,
        once,
        oracle,
        none,
    )
}


def get_scheduler(scheduler: str | SchedulerFunction) -> SchedulerFunction:
    """A built-in scheduler by name, another by its import path; a function is passed through.

    Raises:
        ValueError: there is none, it must not be imported, or it does not take one argument.
    """
    if isinstance(scheduler, str):
        if scheduler in SCHEDULERS:
            return SCHEDULERS[scheduler]
        if "." not in scheduler:
            meant, known = did_you_mean(scheduler, SCHEDULERS), ", ".join(SCHEDULERS)
            raise ValueError(
                f"unknown scheduler {scheduler!r}{meant} (there are {known}, or give a function's import path)"
            )
        scheduler = load_named("scheduler", scheduler)
    if not callable(scheduler):
        raise ValueError(f"a scheduler is a function of one argument, known, not {scheduler!r}")
    _check_signature(scheduler)
    return scheduler


def layers_of(scheduler: SchedulerFunction) -> list[SchedulerFunction]:
    """The scheduler, and what :func:`gated`, ``functools.partial`` or ``functools.wraps`` were put around, in turn."""
    inner = scheduler.func if isinstance(scheduler, partial) else getattr(scheduler, "__wrapped__", None)
    return [scheduler] if inner is None else [scheduler, *layers_of(inner)]


def built_in_name(scheduler: str | SchedulerFunction) -> str | None:
    """The name in :data:`SCHEDULERS` of what decides, within all its layers; None of one that is the user's own."""
    decides = layers_of(get_scheduler(scheduler))[-1]
    return next((name for name, function in SCHEDULERS.items() if function is decides), None)


def name_of(scheduler: str | SchedulerFunction) -> str:
    """What tables and files call a scheduler: its name, and of a ``functools.partial`` the arguments too."""
    if isinstance(scheduler, partial):
        given = [*map(repr, scheduler.args), *(f"{key}={value!r}" for key, value in scheduler.keywords.items())]
        return f"{name_of(scheduler.func)}({', '.join(given)})"
    return scheduler if isinstance(scheduler, str) else getattr(scheduler, "__name__", type(scheduler).__name__)


def _check_signature(scheduler: Callable) -> None:
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    parameters = inspect.signature(scheduler).parameters.values()
    needed = [p.name for p in parameters if p.kind in positional and p.default is p.empty]
    if len(needed) > 1:
        raise ValueError(
            f"a scheduler takes one argument, known; this one takes {', '.join(needed)}. Wrap it: "
            "lambda known: scheduler(known.age, known, known.demand, known.budget, known.memory)"
        )


def _grant(score: Tensor, known: Known) -> Tensor:
    return grant(score, known.candidate, known.demand, known.budget)


def _weighted(score: Tensor, known: Known) -> Tensor:
    return score if known.weight is None else score * known.weight


def _gate(known: Known, snr_gate: bool) -> Tensor:
    return known.candidate & known.above_threshold if snr_gate else known.candidate
