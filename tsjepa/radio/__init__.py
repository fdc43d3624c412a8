"""The radio and the schedulers: propagation, link, codecs and schedulers, as plain functions of tensors."""

from tsjepa.radio.age import (
    mean_age_lower_bound,
    mean_age_opportunistic,
    mean_age_random,
    mean_age_round_robin,
    whittle_index,
)
from tsjepa.radio.deployment import PAPER_LITERAL, Deployment
from tsjepa.radio.grant import grant
from tsjepa.radio.knowledge import Known
from tsjepa.radio.link import capacity, ergodic_efficiency, outage_probability, resource_units, units_per_slot
from tsjepa.radio.loss import GilbertElliott, IidLoss
from tsjepa.radio.path_loss import los_probability, path_loss_db
from tsjepa.radio.schedulers import SCHEDULERS, gated, periodic
from tsjepa.radio.simulation import AgeTrace, simulate_ages

__all__ = [
    "PAPER_LITERAL",
    "SCHEDULERS",
    "AgeTrace",
    "Deployment",
    "GilbertElliott",
    "IidLoss",
    "Known",
    "capacity",
    "ergodic_efficiency",
    "gated",
    "grant",
    "los_probability",
    "mean_age_lower_bound",
    "mean_age_opportunistic",
    "mean_age_random",
    "mean_age_round_robin",
    "outage_probability",
    "path_loss_db",
    "periodic",
    "resource_units",
    "simulate_ages",
    "units_per_slot",
    "whittle_index",
]
