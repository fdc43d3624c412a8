"""Packets' numbers, which start again at 0 where their field is full."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

FIELDS = (1 << 16, 1 << 32)  # how many numbers the usual fields hold: 16 bits (ping, RTP, MQTT) or 32


def count_of(number: int, last: int, size: int = FIELDS[0]) -> int:
    """The packet's count: that of its ``number`` that is nearest to ``last``, the count of the packet before.

    Args:
        number: in 0..``size`` - 1.
        last: 0 before the first packet; no count lies a field before it.
        size: how many numbers the field holds.
    """
    return number + size * max(0, round((last - number) / size))


def counts_of(numbers: np.ndarray) -> tuple[np.ndarray, int]:
    """Counts [N] of packets in the order in which they came, and how often their numbers [N] started again.

    The field is the smallest that holds all numbers; a step back by more than half of it is a new start.
    """
    size = next((size for size in FIELDS if numbers.max() < size), None)
    if size is None or numbers.min() < 0 or not (np.diff(numbers) < -(size // 2)).any():
        return numbers, 0
    counts = np.array(list(accumulate(numbers.tolist(), lambda last, number: count_of(number, last, size))), np.int64)
    return counts, int(counts.max() // size)
