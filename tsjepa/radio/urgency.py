"""How a device's urgency travels: a few bits in each request, saturating at full scale."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class UrgencyCode:
    """Urgencies >= 0 as codes of ``bits`` bits.

    Code 0 stands for anything below ``smallest``; the other levels are even in decibels from there to ``full_scale``.
    Values above full scale, infinity included, have the last code: a device that is lost does not outbid the others
    without end.

    Attributes:
        bits: per request; 1 to 16.
        full_scale: urgency of the last code, in the urgency's own unit, such as the actuator's range.
        smallest: urgency of code 1; with one bit, whose only level is full scale, it is not used.
    """

    bits: int
    full_scale: float
    smallest: float

    def __post_init__(self):
        if not 1 <= self.bits <= 16:
            raise ValueError(f"{self.bits} bits for an urgency: choose 1 to 16")
        if not 0 < self.smallest < self.full_scale:
            raise ValueError(
                f"the smallest urgency, {self.smallest:g}, must lie between 0 and {self.full_scale:g}: choose smallest "
                "above 0 and full_scale above smallest"
            )

    def levels(self) -> Tensor:
        """Urgency that each code stands for, [2^bits] float64, ascending from 0."""
        last = 2**self.bits - 1
        code = torch.arange(last + 1, dtype=torch.float64)
        if last == 1:
            return torch.tensor([0.0, self.full_scale], dtype=torch.float64)
        grown = self.smallest * (self.full_scale / self.smallest) ** ((code - 1) / (last - 1))
        return grown.masked_fill(code == 0, 0.0)

    def encode(self, urgency: Tensor) -> Tensor:
        """Codes, int64: the highest level that the urgency reaches, so that no request says more than there is.

        Raises:
            ValueError: an urgency that is negative or not a number.
        """
        if not bool((urgency >= 0).all()):
            raise ValueError("an urgency is negative or not a number")
        # a level reaches itself in spite of rounding
        levels = self.levels().to(urgency.device) * (1 - 1e-12)
        return torch.bucketize(urgency.to(torch.float64).contiguous(), levels, right=True) - 1

    def decode(self, code: Tensor) -> Tensor:
        """Urgency that the base station reads, float64."""
        return self.levels().to(code.device)[code]

    def changed(self, urgency: Tensor, said: Tensor, by: int) -> Tensor:
        """Whether the code of an urgency is at least ``by`` codes away from that of what was ``said``, bool."""
        return (self.encode(urgency) - self.encode(said)).abs() >= by

    def signalling_bits(self, requests: Tensor, named: bool = False) -> Tensor:
        """Bits spent by each device, int64: ``bits`` where ``requests`` [..., I] bool is set.

        Args:
            requests: who says something.
            named: a request has no place of its own in the uplink, and names its device in ceil(log2 I) more bits.
        """
        name = (requests.shape[-1] - 1).bit_length() if named else 0
        return (self.bits + name) * requests.to(torch.int64)
