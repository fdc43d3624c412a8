"""How long packets travel, in what order they arrive, and acknowledgements that are lost.

A delay law draws the delay of the packet that a device sends in a slot, as a pure function of (seed, device, episode,
slot), in whole slots or in milliseconds. A packet with a delay of 0 slots is used in the slot in which it was sent.
Packets may overtake each other, so each carries its slot as a sequence number.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from tsjepa.radio.streams import uniform

UNITS = ("slots", "ms")


class DelayLaw(Protocol):
    """Delays of the packets sent in a slot, in ``unit``; the counters are int64 and broadcast, the result float64."""

    @property
    def unit(self) -> str: ...

    def draw(self, seed: int, device: Tensor, episode: Tensor, slot: Tensor, stream: str = "delay") -> Tensor: ...


@dataclass(frozen=True)
class ConstantDelay:
    """Every packet takes ``value``."""

    value: float
    unit: str = "slots"

    def __post_init__(self):
        _check(self.unit, value=self.value)

    def draw(self, seed: int, device: Tensor, episode: Tensor, slot: Tensor, stream: str = "delay") -> Tensor:
        shape = torch.broadcast_shapes(device.shape, episode.shape, slot.shape)
        return torch.full(shape, float(self.value), dtype=torch.float64, device=device.device)


@dataclass(frozen=True)
class UniformDelay:
    """Uniform between ``low`` and ``high``; in slots, each whole number from ``low`` to ``high`` is as likely."""

    low: float
    high: float
    unit: str = "slots"

    def __post_init__(self):
        _check(self.unit, low=self.low, high=self.high)
        if self.high < self.low:
            raise ValueError(f"high {self.high:g} must be at least low {self.low:g}")
        if self.unit == "slots" and not (float(self.low).is_integer() and float(self.high).is_integer()):
            raise ValueError(f"low {self.low:g} and high {self.high:g} must be whole numbers of slots: or give ms")

    def draw(self, seed: int, device: Tensor, episode: Tensor, slot: Tensor, stream: str = "delay") -> Tensor:
        share = uniform(seed, stream, device, episode, slot)
        if self.unit == "slots":
            return self.low + (share * (self.high - self.low + 1)).floor()
        return self.low + share * (self.high - self.low)


@dataclass(frozen=True)
class GammaDelay:
    """``shift`` and a gamma variable of mean ``mean_excess`` on top; ``shape`` 1 is the shifted exponential.

    ``shape`` is a whole number (Erlang's law): then the sum of that many exponentials, each a counter-based draw, is
    exact on any device.
    """

    shift: float
    mean_excess: float
    shape: int = 1
    unit: str = "ms"

    def __post_init__(self):
        _check(self.unit, shift=self.shift, mean_excess=self.mean_excess)
        if self.shape != int(self.shape) or self.shape < 1:
            raise ValueError(f"shape {self.shape:g} must be a whole number of at least 1")

    def draw(self, seed: int, device: Tensor, episode: Tensor, slot: Tensor, stream: str = "delay") -> Tensor:
        stage = torch.arange(self.shape, device=device.device)
        shares = uniform(seed, stream, device.unsqueeze(-1), episode.unsqueeze(-1), slot.unsqueeze(-1), stage)
        return self.shift - self.mean_excess / self.shape * torch.log(shares).sum(-1)


@dataclass(frozen=True)
class RecordedDelay:
    """Delays as they were measured, in their order and from the start again after the last.

    Each device and episode starts at a drawn place, so that devices do not run in step.
    """

    values: tuple[float, ...]
    unit: str = "ms"

    def __post_init__(self):
        if not self.values:
            raise ValueError("a recording of delays is empty")
        _check(self.unit, **{"the smallest delay": min(self.values)})

    def draw(self, seed: int, device: Tensor, episode: Tensor, slot: Tensor, stream: str = "delay") -> Tensor:
        values = torch.tensor(self.values, dtype=torch.float64, device=device.device)
        start = (uniform(seed, stream, device, episode, torch.full_like(slot, -1)) * len(values)).to(torch.int64)
        return values[(start + slot) % len(values)]


def whole_slots(delay: Tensor, unit: str, slot_s: float) -> Tensor:
    """Slots after which a packet can be used, int64: delays in slots rounded up, in ms counted in slots begun.

    A packet that needs 19 ms is used in the slot of 20 ms in which it was sent, one that needs 20 ms in the next.
    """
    if unit == "slots":
        return delay.ceil().to(torch.int64)
    # 1e-9 keeps 60 ms at three slots of 20 ms, whatever the rounding
    return (delay / (1e3 * slot_s) + 1e-9).floor().to(torch.int64)


class InFlight(NamedTuple):
    """Packets on their way, by the number of slots until they arrive: 0 to H - 1.

    Attributes:
        payload: [..., I, H, *size], zeros where there is none.
        sequence: [..., I, H] int64, the slot in which each was sent, -1 where there is none.
    """

    payload: Tensor
    sequence: Tensor


def nothing_in_flight(shape: tuple[int, ...], horizon: int, like: Tensor) -> InFlight:
    """No packets, for devices of ``shape`` [..., I] and payloads like ``like`` [..., I, *size]."""
    if horizon < 1:
        raise ValueError(f"horizon {horizon} must be at least 1 slot")
    payload = like.new_zeros((*shape, horizon, *like.shape[len(shape) :]))
    return InFlight(payload, torch.full((*shape, horizon), -1, dtype=torch.int64, device=like.device))


def send(flight: InFlight, sent: Tensor, payload: Tensor, sequence: Tensor, delay: Tensor) -> tuple[InFlight, Tensor]:
    """Put the packets of this slot on their way.

    Of two packets of a device that would arrive in one slot the older is dropped, since the newer one replaces it.

    Args:
        flight: packets on their way, H slots far.
        sent: [..., I] bool.
        payload: [..., I, *size].
        sequence: int64, broadcast to [..., I]; larger for newer packets.
        delay: [..., I] int64 slots.

    Returns:
        The packets on their way, and [..., I] bool: packets that were sent and would take H slots or longer, which are
        lost.
    """
    horizon = flight.sequence.shape[-1]
    late = sent & (delay >= horizon)
    place = torch.nn.functional.one_hot(delay.clamp(max=horizon - 1), horizon).bool() & (sent & ~late).unsqueeze(-1)
    size = payload.shape[sent.ndim :]
    wide = place.reshape(*place.shape, *[1] * len(size))
    number = torch.broadcast_to(torch.as_tensor(sequence, device=sent.device), sent.shape).unsqueeze(-1)
    return InFlight(
        torch.where(wide, payload.unsqueeze(sent.ndim), flight.payload), torch.where(place, number, flight.sequence)
    ), late


def receive(flight: InFlight) -> tuple[InFlight, Tensor, Tensor, Tensor]:
    """Take the packets that arrive in this slot, and bring the others one slot nearer.

    Returns:
        The packets still on their way; [..., I] bool who hears one; its payload [..., I, *size] (zeros elsewhere); and
        its sequence number [..., I] (-1 elsewhere). A number below that of an earlier arrival is an overtaken packet.
    """
    axis = flight.sequence.ndim - 1
    payload, sequence = flight.payload.select(axis, 0), flight.sequence[..., 0]
    moved = (values.roll(-1, axis) for values in flight)
    later = InFlight(*moved)
    later.payload.select(axis, -1).zero_()
    later.sequence[..., -1] = -1
    return later, sequence >= 0, payload, sequence


def acknowledged(
    delivered: Tensor, probability: float, seed: int, device: Tensor, episode: Tensor, slot: Tensor
) -> Tensor:
    """Which deliveries the device learns of, bool: an acknowledgement is lost with the given probability.

    Device and controller then disagree: the controller has the update, and the device believes that it has not.
    """
    if not 0.0 <= probability <= 1.0:
        raise ValueError(f"ACK loss probability {probability:g} must lie in [0, 1]")
    return delivered & (uniform(seed, "ack", device, episode, slot) >= probability)


def _check(unit: str, **values: float) -> None:
    if unit not in UNITS:
        raise ValueError(f"unknown unit {unit!r} of a delay: choose 'slots' or 'ms'")
    for name, value in values.items():
        if not 0 <= value < float("inf"):
            raise ValueError(f"{name} {value:g} must be a finite delay of at least 0")
