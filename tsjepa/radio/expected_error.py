"""What a controller may expect of its own error about a device, learned from what it has received: no signalling.

Whenever an update arrives, the controller sees how far it was wrong, and at which age. Pure functions of tensors with I
devices on the last dimension and any batch before it.
"""

from typing import NamedTuple

import torch
from torch import Tensor

_AGES = 20  # twice as many as doublings: the last begins at an age of 724 slots
_COMMANDS = (0.05, 0.25)  # borders between small, middle and large commands, as parts of the actuator's range
_KINDS = len(_COMMANDS) + 2  # and devices that were never heard
CELLS = _KINDS * _AGES
WIDTH = 2 * CELLS + 2
"""Numbers per device that a record takes."""


class ErrorRecord(NamedTuple):
    """Errors that were seen, by the situation in which an update arrived.

    Attributes:
        error, heard: [..., I, CELLS] float64, sum of the errors and their number.
        ratio, updates: [..., I] float64, sum of the device's errors, each over what the fleet was expected to
            have in its place, and their number.
    """

    error: Tensor
    heard: Tensor
    ratio: Tensor
    updates: Tensor


def start_record(shape: tuple[int, ...], device: torch.device | str = "cpu") -> ErrorRecord:
    """Nothing seen yet, for devices of ``shape`` [..., I]."""
    return unpack(torch.zeros((*shape, WIDTH), dtype=torch.float64, device=device))


def situation(age: Tensor, command: Tensor, informed: Tensor) -> Tensor:
    """Cell of each device, [..., I] int64: its age, and how large a command the belief about it asks for.

    Args:
        age: slots since the last delivery, >= 1; cells are half a doubling wide.
        command: [..., I] size of the command, as a part of the actuator's range.
        informed: [..., I] bool; devices that were never heard are a kind of their own.
    """
    half_doublings = (2 * torch.log2(age.to(torch.float64))).floor().clamp(0, _AGES - 1).to(torch.int64)
    kind = torch.bucketize(command.to(torch.float64), torch.tensor(_COMMANDS, dtype=torch.float64, device=age.device))
    return torch.where(informed, kind, _KINDS - 1) * _AGES + half_doublings


def expected(record: ErrorRecord, cell: Tensor, strength: float = 10.0) -> Tensor:
    """Error that is expected of each device in its situation ``cell``, [..., I] float64.

    The fleet's mean in this situation, times how much worse than the fleet the device has been. A situation that was
    seen fewer than ``strength`` times is taken for a random walk, whose error grows with the square root of the age;
    and no error shrinks with age, so that nobody is forgotten who has been silent for longer than anybody before.
    """
    own = (record.ratio + strength) / (record.updates + strength)
    return own * _of_the_fleet(record, cell, strength)


def _of_the_fleet(record: ErrorRecord, cell: Tensor, strength: float) -> Tensor:
    error, heard = (x.sum(-2).unflatten(-1, (_KINDS, _AGES)) for x in (record.error, record.heard))
    root = 2.0 ** (torch.arange(_AGES, dtype=torch.float64, device=cell.device) / 4)
    step = (error.sum(-1, keepdim=True) + 1.0) / ((heard * root).sum(-1, keepdim=True) + 1.0)
    mean = (error + strength * step * root) / (heard + strength)
    seen = mean.masked_fill(heard == 0, 0.0).cummax(-1).values
    return torch.where(heard == 0, torch.maximum(mean, seen), seen).flatten(-2).gather(-1, cell)


def learn(record: ErrorRecord, cell: Tensor, error: Tensor, heard: Tensor, strength: float = 10.0) -> ErrorRecord:
    """The record after a slot.

    Args:
        record: before it.
        cell: [..., I] situations as the slot began.
        error: [..., I] what the updates that arrived have shown.
        heard: [..., I] bool, where one arrived that teaches something.
        strength: as of :func:`expected`.
    """
    error = torch.where(heard, error.to(torch.float64), 0.0)
    here = torch.nn.functional.one_hot(cell, CELLS) * heard.unsqueeze(-1)
    return ErrorRecord(
        record.error + here * error.unsqueeze(-1),
        record.heard + here,
        record.ratio + error / _of_the_fleet(record, cell, strength),
        record.updates + heard,
    )


def pack(record: ErrorRecord) -> Tensor:
    """[..., I, WIDTH] float64, as a fleet carries it along."""
    return torch.cat((record.error, record.heard, torch.stack(record[2:], -1)), -1)


def unpack(packed: Tensor) -> ErrorRecord:
    """The record of :func:`pack`."""
    error, heard, own = packed.split((CELLS, CELLS, 2), -1)
    return ErrorRecord(error, heard, *own.unbind(-1))
