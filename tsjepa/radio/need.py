"""Schedulers by need: what a delivery is worth to the plant itself, instead of the age of what is known of it."""

import torch
from torch import Tensor

from tsjepa.radio.age import whittle_index
from tsjepa.radio.grant import grant
from tsjepa.radio.knowledge import Known

_TIE = 1e-9  # of a logarithm of an age, against needs that matter from about 1e-3 on


def urgency(known: Known):
    """Largest urgency that a delivery is expected to end, per resource unit; equal ones go by age.

    What a device says of itself is worth its probability of success times its priority. A slot that has room for more
    than those in need serves the others by age.
    """
    return _by_gain(_wanted(known.urgency, "urgency", "what devices say of themselves"), known)


def first_contact(known: Known):
    """Whoever says anything comes first, the largest expected urgency leading; what is left goes by ``channel_aware``.

    For devices that ask until they are heard for the first time.
    """
    asked = _scaled(known.success * _wanted(known.urgency, "urgency", "what devices say of themselves"), known)
    age = known.age.to(torch.float64)
    by_age = _scaled(known.success * (1 + age * (age + 2)), known)
    return _granted(torch.where(asked > 0, by_age.amax(-1, keepdim=True) + asked, by_age), known)


def expected_urgency(known: Known):
    """The same by what the controller expects a delivery to save, for which no device says anything."""
    return _by_gain(_wanted(known.expected_gain, "expected_gain", "a record of the controller's errors"), known)


def genie(known: Known):
    """Largest error of the command as it is in this slot, which nobody can know: a bound for the two others."""
    return _by_gain(_wanted(known.true_error, "true_error", "the true state of the devices"), known)


def channel_aware_cost(known: Known):
    """Largest drop of the plant's own cost of age that a transmission is expected to bring, per resource unit.

    It is ``channel_aware`` with the weight of :func:`tsjepa.radio.cost.cost_weight`.
    """
    return _by_gain(_wanted(known.age_cost, "age_cost", "the plant's own cost of age"), known)


def whittle_cost(known: Known):
    """Whittle's index of a cost that grows with the age as fast as the plant's own at this age, per resource unit."""
    cost = _wanted(known.age_cost, "age_cost", "the plant's own cost of age")
    slope = cost / known.age.clamp(min=1)
    return _by_score(slope * whittle_index(known.age, known.success), known)


def _by_gain(need: Tensor, known: Known) -> tuple[Tensor, Tensor]:
    return _by_score(known.success * (need + _TIE * torch.log1p(known.age.to(torch.float64))), known)


def _by_score(score: Tensor, known: Known) -> tuple[Tensor, Tensor]:
    return _granted(_scaled(score, known), known)


def _scaled(score: Tensor, known: Known) -> Tensor:
    """By priority and per resource unit."""
    score = score if known.weight is None else score * known.weight
    return score if known.demand is None else score / known.demand.clamp(min=1)


def _granted(score: Tensor, known: Known) -> tuple[Tensor, Tensor]:
    return grant(score, known.candidate & (known.success > 0), known.demand, known.budget), known.memory


def _wanted(value: Tensor | None, field: str, what: str) -> Tensor:
    if value is None:
        raise ValueError(
            f"this scheduler decides by known.{field}, {what}, which nothing writes here: run it in a fleet of plants, "
            "and give Radio its requests where a scheduler of your own calls this one"
        )
    return value
