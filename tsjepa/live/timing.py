"""A fixed rate by the monotonic clock, and histograms of how long things take."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager

import numpy as np

SHORTEST_S, PER_DECADE, DECADES = 1e-6, 20, 7  # of a histogram: 1 microsecond to 10 seconds, in steps of 12 %
OLDEST = 128  # slots, the last bar of a histogram of ages


class Durations:
    """A histogram of seconds in bars that are even in the logarithm; it takes the same memory for ever."""

    def __init__(self) -> None:
        self.bars = np.zeros(PER_DECADE * DECADES + 1, np.int64)
        self.longest = self.total = 0.0

    def add(self, seconds: float) -> None:
        """Counts one duration."""
        bar = np.log10(max(seconds, SHORTEST_S) / SHORTEST_S) * PER_DECADE
        self.bars[min(int(bar), len(self.bars) - 1)] += 1
        self.longest = max(self.longest, seconds)
        self.total += seconds

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Counts how long the block takes."""
        start = time.perf_counter()
        yield
        self.add(time.perf_counter() - start)

    def quantile(self, share: float) -> float:
        """Seconds that at least ``share`` of the durations stay within (the upper end of a bar); 0 for none."""
        count = int(self.bars.sum())
        if not count:
            return 0.0
        bar = int(np.searchsorted(self.bars.cumsum(), share * count))
        return min(SHORTEST_S * 10 ** ((bar + 1) / PER_DECADE), self.longest)

    def summary(self) -> dict[str, float]:
        """Number, and mean, median, 99 % and largest in milliseconds."""
        count = int(self.bars.sum())
        figures = {"mean": self.total / max(count, 1), "p50": self.quantile(0.5), "p99": self.quantile(0.99)}
        figures["max"] = self.longest
        return {"count": count} | {f"{name}_ms": round(1e3 * value, 4) for name, value in figures.items()}


class Ages:
    """A histogram of whole slots; what is older than the last bar counts there."""

    def __init__(self) -> None:
        self.bars = np.zeros(OLDEST + 1, np.int64)

    def add(self, ages: np.ndarray) -> None:
        """Counts ages int64 [n]."""
        np.add.at(self.bars, np.clip(ages, 0, OLDEST), 1)

    def summary(self) -> dict[str, int]:
        """How often each age was met."""
        return {str(age): int(count) for age, count in enumerate(self.bars) if count}


class Metronome:
    """Slots of a fixed length by the monotonic clock: a slot's start follows from its number, so that nothing drifts.

    ``missed`` counts slots whose work was not begun before the next one started; they are left out.

    Args:
        period: seconds.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.started = 0.0
        self.missed = 0

    def begins(self, slot: int) -> float:
        """When a slot starts, by ``time.monotonic``."""
        return self.started + slot * self.period

    async def slots(self, count: int | None, stop: asyncio.Event) -> AsyncIterator[int]:
        """The numbers of the slots from 0 on, each when it starts: ``count`` of them, or until ``stop``."""
        self.started, slot = time.monotonic(), 0
        while not stop.is_set() and (count is None or slot < count):
            yield slot
            late = int((time.monotonic() - self.begins(slot + 1)) / self.period)
            if late > 0:
                self.missed += late
            slot += 1 + max(late, 0)
            await asyncio.sleep(max(0.0, self.begins(slot) - time.monotonic()))
