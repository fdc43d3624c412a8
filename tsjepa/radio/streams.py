"""Counter-based random numbers: every draw is a pure function of (seed, stream, counters).

No draw depends on how many were made before it. So two schedulers see the same channel, a device that resets moves
nobody else's channel by a bit, and nothing has to be stored to replay a slot. The generator is SplitMix64's finaliser
(Steele et al., 2014), applied once per counter, on int64 tensors of any shape and device.
"""

import torch
from torch import Tensor

STREAMS = (
    *("position", "los", "shadowing", "fading", "loss", "scheduler"),
    *("delay", "ack", "downlink_delay", "downlink_loss"),
    *("repetition", "decoding", "trace", "trace_loss"),
)


def _signed(value: int) -> int:
    value &= 0xFFFFFFFFFFFFFFFF
    return value - (1 << 64) if value >= 1 << 63 else value


_GOLDEN = _signed(0x9E3779B97F4A7C15)
_MULTIPLIER_1 = _signed(0xBF58476D1CE4E5B9)
_MULTIPLIER_2 = _signed(0x94D049BB133111EB)


def uniform(seed: int, stream: str, *counters: Tensor) -> Tensor:
    """Uniform numbers strictly inside (0, 1).

    Args:
        seed: the experiment's seed.
        stream: one of ``STREAMS``; streams are independent of each other.
        counters: int64 tensors that broadcast together, such as device, episode, slot.

    Returns:
        float64, the broadcast shape, 52 random bits each.
    """
    if stream not in STREAMS:
        raise ValueError(f"unknown random stream {stream!r}: choose one of {', '.join(STREAMS)}")
    device = counters[0].device
    bits = _mix(torch.full((), _signed(seed), dtype=torch.int64, device=device))
    bits = _mix(bits + _signed((STREAMS.index(stream) + 1) * _GOLDEN))
    for counter in counters:
        bits = _mix(bits + (counter + 1) * _GOLDEN)
    return (_shift_right(bits, 12).to(torch.float64) + 0.5) * 2.0**-52


def normal(seed: int, stream: str, *counters: Tensor) -> Tensor:
    """Standard normal numbers, float64; arguments as for :func:`uniform`."""
    return torch.special.ndtri(uniform(seed, stream, *counters))


def _mix(bits: Tensor) -> Tensor:
    bits = (bits ^ _shift_right(bits, 30)) * _MULTIPLIER_1
    bits = (bits ^ _shift_right(bits, 27)) * _MULTIPLIER_2
    return bits ^ _shift_right(bits, 31)


def _shift_right(bits: Tensor, count: int) -> Tensor:
    # int64 >> is arithmetic: the mask drops the copies of the sign bit
    return (bits >> count) & ((1 << (64 - count)) - 1)
