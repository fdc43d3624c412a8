"""What a controller may expect of its own error about a device, learned from what it has received: no signalling.

Whenever an update arrives, the controller sees how far it was wrong, and at which age. It learns the fleet's mean error
by age, of devices that it has heard and of those that it has not. Pure functions of tensors with I devices on the last
dimension and any batch before it.
"""

from typing import NamedTuple

import torch
from torch import Tensor

OLDEST = 512  # slots; older information is no worse
_AGES = 19  # cells of age, two a doubling: cell j stands for the age 2^(j / 2)
CELLS = 2 * _AGES
"""Situations in which errors are averaged: the age's cell, of a device that was heard or never was."""
_STRENGTH = 10.0  # updates that what is assumed of a cell is worth
_FIRST_STEP = 0.01  # error after one slot before anything was heard, as a part of the actuator's range


class ErrorRecord(NamedTuple):
    """Errors that updates have shown, by the situation in which they arrived.

    Attributes:
        error, updates: [..., I, CELLS] float64, sum of the errors and their number.
    """

    error: Tensor
    updates: Tensor


def start_record(shape: tuple[int, ...], device: torch.device | str = "cpu") -> ErrorRecord:
    """Nothing seen yet, for devices of ``shape`` [..., I]."""
    return ErrorRecord(*torch.zeros((2, *shape, CELLS), dtype=torch.float64, device=device))


def situation(age: Tensor, informed: Tensor) -> Tensor:
    """Of each device, [..., I] int64.

    Args:
        age: slots since the last delivery, >= 1.
        informed: [..., I] bool, whether it was ever heard.
    """
    return torch.where(informed, 0, OLDEST) + age.to(torch.int64).clamp(max=OLDEST) - 1


def expected_gain(record: ErrorRecord, situations: Tensor) -> Tensor:
    """What it is expected to save to hear of a device of age h now, [..., I] float64: sum_{j <= h} e(h) - e(j).

    e(j) is the error expected at age j after a delivery. The sum is how much smaller the errors of the h slots after a
    delivery are than the error now; it is Whittle's index of the cost e on a link that loses nothing.
    """
    curves = expected_errors(record)
    ages = torch.arange(1, OLDEST + 1, dtype=torch.float64, device=curves.device)
    saved = ages * curves - curves[..., :1, :].cumsum(-1)
    return saved.clamp(min=0.0).flatten(-2).gather(-1, situations)


def learn(record: ErrorRecord, situations: Tensor, error: Tensor, heard: Tensor) -> ErrorRecord:
    """The record after a slot.

    Args:
        record: before it.
        situations: [..., I] as the slot began.
        error: [..., I] what the updates that arrived have shown.
        heard: [..., I] bool, where one arrived that teaches something.
    """
    age = (situations % OLDEST + 1).to(torch.float64)
    cell = situations // OLDEST * _AGES + (2 * torch.log2(age)).round().to(torch.int64)
    here = torch.nn.functional.one_hot(cell, CELLS) * heard.unsqueeze(-1)
    error = torch.where(heard, error.to(torch.float64), 0.0)
    return ErrorRecord(record.error + here * error.unsqueeze(-1), record.updates + here)


def expected_errors(record: ErrorRecord) -> Tensor:
    """The fleet's mean error at the ages 1 to OLDEST, [..., 2, OLDEST] float64: of devices heard, and never heard.

    Between the cells' ages it is interpolated. A cell that was seen seldom is taken for a part of a random walk, whose
    error grows with the square root of the age. And no error shrinks with age, so that nobody is forgotten who has been
    silent for longer than anybody before.
    """
    error, updates = (x.sum(-2).unflatten(-1, (2, _AGES)) for x in record)
    root = 2.0 ** (torch.arange(_AGES, dtype=torch.float64, device=error.device) / 4)
    # nobody knows what a device needs that was never heard: as much as the actuator has
    assumed = torch.tensor([[_FIRST_STEP], [1.0]], dtype=torch.float64, device=error.device)
    step = (error.sum(-1, keepdim=True) + assumed) / ((updates * root).sum(-1, keepdim=True) + 1.0)
    mean = (error + _STRENGTH * step * root) / (updates + _STRENGTH)
    seen = mean.masked_fill(updates == 0, 0.0).cummax(-1).values
    cells = torch.where(updates == 0, torch.maximum(mean, seen), seen)
    place = 2 * torch.log2(torch.arange(1, OLDEST + 1, dtype=torch.float64, device=error.device))
    low = place.floor().to(torch.int64).clamp(max=_AGES - 2)
    return torch.lerp(cells[..., low], cells[..., low + 1], place - low)
