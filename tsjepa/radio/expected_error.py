"""What a controller may expect of its own error about a device, learned from what it has received: no signalling.

Whenever an update arrives, the controller sees how far it was wrong, and at which age. Pure functions of tensors with I
devices on the last dimension and any batch before it.
"""

from typing import NamedTuple

import torch
from torch import Tensor

OLDEST = 512  # slots; older information is no worse
_CELLS_OF_AGE = 19  # two a doubling: cell j stands for the age 2^(j / 2)
_COMMANDS = (0.05, 0.25)  # borders between small, middle and large commands, as parts of the actuator's range
_KINDS = len(_COMMANDS) + 2  # and devices that were never heard
CELLS = _KINDS * _CELLS_OF_AGE
WIDTH = 2 * CELLS + 3
"""Numbers per device that a record takes."""
_STRENGTH = 10.0  # updates that what is assumed of a cell is worth
_LARGEST_RATIO = 5.0  # what one update can say against a device
_FIRST_STEP = 0.01  # error after one slot before anything was heard, as a part of the actuator's range


class ErrorRecord(NamedTuple):
    """Errors that were seen, by the situation in which an update arrived.

    Attributes:
        error, heard: [..., I, CELLS] float64, sum of the errors and their number.
        ratio, square, updates: [..., I] float64, sum of the device's errors, each over what the fleet was expected to
            have in its place, sum of the squares of these ratios, and their number.
    """

    error: Tensor
    heard: Tensor
    ratio: Tensor
    square: Tensor
    updates: Tensor


def start_record(shape: tuple[int, ...], device: torch.device | str = "cpu") -> ErrorRecord:
    """Nothing seen yet, for devices of ``shape`` [..., I]."""
    return unpack(torch.zeros((*shape, WIDTH), dtype=torch.float64, device=device))


def situation(age: Tensor, command: Tensor, informed: Tensor) -> Tensor:
    """Of each device, [..., I] int64: its age, and how large a command the belief about it asks for.

    Args:
        age: slots since the last delivery, >= 1.
        command: [..., I] size of the command, as a part of the actuator's range.
        informed: [..., I] bool; devices that were never heard are a kind of their own.
    """
    border = torch.tensor(_COMMANDS, dtype=torch.float64, device=age.device)
    kind = torch.where(informed, torch.bucketize(command.to(torch.float64), border), _KINDS - 1)
    return kind * OLDEST + age.to(torch.int64).clamp(max=OLDEST) - 1


def expected_error(record: ErrorRecord, situations: Tensor) -> Tensor:
    """Error of the command that is expected of each device, [..., I] float64, in the unit of the errors seen."""
    return _own(record) * _of_situation(_curve(record), situations)


def expected_gain(record: ErrorRecord, situations: Tensor) -> Tensor:
    """What it is expected to save to hear of a device of age h now, [..., I] float64: sum_{j <= h} e(h) - e(j).

    e(j) is the error expected at age j. The sum is how much smaller the errors of the h slots after a delivery are than
    the error now; it is Whittle's index of the cost e on a link that loses nothing. The errors after the delivery of a
    device that was never heard are those of one with a small command.
    """
    curve = _curve(record)
    ages = torch.arange(1, OLDEST + 1, dtype=torch.float64, device=curve.device)
    after = torch.cat((curve[..., :-1, :], curve[..., :1, :]), -2).cumsum(-1)
    return _own(record) * _of_situation((ages * curve - after).clamp(min=0.0), situations)


def learn(record: ErrorRecord, situations: Tensor, error: Tensor, heard: Tensor) -> ErrorRecord:
    """The record after a slot.

    Args:
        record: before it.
        situations: [..., I] as the slot began.
        error: [..., I] what the updates that arrived have shown.
        heard: [..., I] bool, where one arrived that teaches something.
    """
    error = torch.where(heard, error.to(torch.float64), 0.0)
    age = (situations % OLDEST + 1).to(torch.float64)
    cell = situations // OLDEST * _CELLS_OF_AGE + (2 * torch.log2(age)).round().to(torch.int64)
    here = torch.nn.functional.one_hot(cell, CELLS) * heard.unsqueeze(-1)
    ratio = (error / _of_situation(_curve(record), situations)).clamp(max=_LARGEST_RATIO)
    return ErrorRecord(
        record.error + here * error.unsqueeze(-1),
        record.heard + here,
        record.ratio + ratio,
        record.square + ratio**2,
        record.updates + heard,
    )


def pack(record: ErrorRecord) -> Tensor:
    """[..., I, WIDTH] float64, as a fleet carries it along."""
    return torch.cat((record.error, record.heard, torch.stack(record[2:], -1)), -1)


def unpack(packed: Tensor) -> ErrorRecord:
    """The record of :func:`pack`."""
    error, heard, own = packed.split((CELLS, CELLS, 3), -1)
    return ErrorRecord(error, heard, *own.unbind(-1))


def _curve(record: ErrorRecord) -> Tensor:
    """The fleet's mean error in every situation, [..., kinds, OLDEST], between the cells' ages by interpolation.

    A cell that was seen seldom is taken for a part of a random walk, whose error grows with the square root of the age,
    as fast as that of devices of its kind, or as that of all which were ever heard. And no error shrinks with age, so
    that nobody is forgotten who has been silent for longer than anybody before.
    """
    error, heard = (x.sum(-2).unflatten(-1, (_KINDS, _CELLS_OF_AGE)) for x in (record.error, record.heard))
    root = 2.0 ** (torch.arange(_CELLS_OF_AGE, dtype=torch.float64, device=error.device) / 4)
    errors, roots = error.sum(-1, keepdim=True), (heard * root).sum(-1, keepdim=True)
    informed = errors[..., :-1, :].sum(-2, keepdim=True) + _FIRST_STEP
    informed = informed / (roots[..., :-1, :].sum(-2, keepdim=True) + 1.0)
    # nobody knows what a device needs that was never heard: as much as the actuator has
    assumed = torch.cat((informed.expand(*errors.shape[:-2], _KINDS - 1, 1), torch.ones_like(informed)), -2)
    step = (errors + _STRENGTH * assumed) / (roots + _STRENGTH)
    mean = (error + _STRENGTH * step * root) / (heard + _STRENGTH)
    seen = mean.masked_fill(heard == 0, 0.0).cummax(-1).values
    cells = torch.where(heard == 0, torch.maximum(mean, seen), seen)
    place = 2 * torch.log2(torch.arange(1, OLDEST + 1, dtype=torch.float64, device=error.device))
    low = place.floor().to(torch.int64).clamp(max=_CELLS_OF_AGE - 2)
    return torch.lerp(cells[..., low], cells[..., low + 1], place - low)


def _of_situation(table: Tensor, situations: Tensor) -> Tensor:
    return table.flatten(-2).gather(-1, situations)


def _own(record: ErrorRecord) -> Tensor:
    """How much worse than the fleet each device is, [..., I], as far as its errors tell (empirical Bayes).

    Its own mean ratio and the fleet's are weighed by how much the ratios of one device scatter and how much the
    devices' means do beyond that (DerSimonian and Laird, 1986, for the variance between them).
    """
    count = record.updates
    total = count.sum(-1, keepdim=True).clamp(min=1.0)
    mean = record.ratio / count.clamp(min=1.0)
    fleet = record.ratio.sum(-1, keepdim=True) / total
    fleet = torch.where(fleet > 0, fleet, 1.0)
    within = (record.square - count * mean**2).sum(-1, keepdim=True) / (count - 1).clamp(min=0).sum(-1, keepdim=True)
    devices = (count > 0).sum(-1, keepdim=True)
    spread = (count * (mean - fleet) ** 2).sum(-1, keepdim=True) - (devices - 1) * within
    between = (spread / (total - (count**2).sum(-1, keepdim=True) / total)).clamp(min=0.0)
    trust = (between * count / (between * count + within)).nan_to_num(0.0)
    return 1.0 + trust * (mean / fleet - 1.0)
