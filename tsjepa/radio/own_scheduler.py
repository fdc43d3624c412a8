"""A scheduler of the user's own, held to what a scheduler may answer; what it raises or returns is said by its name."""

import textwrap
import traceback
from functools import partial
from typing import Any

import torch
from torch import Tensor

from tsjepa.radio.knowledge import Known
from tsjepa.radio.schedulers import SchedulerFunction, layers_of, name_of
from tsjepa.support.nearest import did_you_mean

_BY_NEED = "only the built-in schedulers by need know it"
# Why a field of Known is None and what to do about it, the likeliest one to be missed first.
ABSENT = {
    "urgency": "give radio.requests, such as '{bits: 4}', in a fleet of plants",
    "expected_gain": _BY_NEED,
    "true_error": _BY_NEED,
    "age_cost": _BY_NEED,
    "weight": "give radio.priority",
    "slot": "choose a plant that counts its slots",
    "demand": "set radio.resource_blocks to null, or count one unit each",
}


def checked(scheduler: SchedulerFunction) -> SchedulerFunction:
    """The scheduler; one that is not this package's own with its answer checked in every slot.

    Nothing after it would notice that more is sent than the radio carries. ``oracle``, ``once`` and ``periodic`` ignore
    the budget on purpose.

    Raises:
        ValueError: in the slot, where it raises anything itself, or its answer is no pair, no flag for each device, or
            beyond the budget.
    """
    module = getattr(scheduler, "__module__", None) or ""  # None of what was typed into an interpreter
    if module.partition(".")[0] == __name__.partition(".")[0]:
        return scheduler
    # a partial can be sent to another process, as the function can
    return partial(_held_to_the_budget, scheduler, _full_name(scheduler))


def _held_to_the_budget(scheduler: SchedulerFunction, name: str, known: Known) -> tuple[Tensor, Tensor]:
    try:
        answer = scheduler(known)
    except Exception as error:
        what = textwrap.shorten(f"{type(error).__name__}: {error}".rstrip("."), 240, placeholder=" ...")
        raise ValueError(f"The scheduler {name} raised {what}{_mend(error, known)}") from error
    if not (isinstance(answer, tuple) and len(answer) == 2 and all(isinstance(part, Tensor) for part in answer)):
        raise ValueError(
            f"The scheduler {name} returned {_described(answer)}: a pair of tensors is wanted, (schedule, memory)."
        )
    schedule, memory = answer
    if schedule.dtype != torch.bool or schedule.shape != known.memory.shape or memory.shape != known.memory.shape:
        raise ValueError(
            f"The scheduler {name} returned a schedule {_described(schedule)} and a memory {_described(memory)}: one "
            f"flag (bool) and one number for each device are wanted, {list(known.memory.shape)}."
        )
    demand = torch.ones_like(schedule, dtype=torch.int64) if known.demand is None else known.demand
    over = demand.masked_fill(~schedule, 0).sum(-1) - known.budget
    if bool((over > 0).any()) or bool((schedule & ~known.candidate).any()):
        raise ValueError(
            f"The scheduler {name} granted up to {max(int(over.max()), 0)} units beyond the budget or picked a device "
            "that is no candidate: end it with grant(score, known.candidate, known.demand, known.budget)."
        )
    return schedule, memory.to(known.memory.dtype)


def _mend(error: Exception, known: Known) -> str:
    """What to do about an exception of a scheduler, as the end of the sentence that names it."""
    if isinstance(error, AttributeError) and isinstance(error.obj, Known):
        return did_you_mean(f"{error.name}", Known._fields) or f"; it has {', '.join(Known._fields)}."
    # without the first frame, which is the call from here
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][1:]
    read = {name for frame in frames for name in frame.f_code.co_names}
    absent = [field for field in ABSENT if field in read and getattr(known, field) is None]
    if "NoneType" in str(error) and absent:
        return f"; known.{absent[0]} is None here: {ABSENT[absent[0]]}."
    return " (TSJEPA_TRACEBACK=1 shows where)."


def _full_name(scheduler: SchedulerFunction) -> str:
    module = getattr(layers_of(scheduler)[-1], "__module__", None)
    return f"{module}.{name_of(scheduler)}" if module else name_of(scheduler)


def _described(value: Any) -> str:
    if isinstance(value, tuple):
        return f"a tuple ({', '.join(map(_described, value))})"
    return f"{list(value.shape)} of {value.dtype}" if isinstance(value, Tensor) else f"a {type(value).__name__}"
