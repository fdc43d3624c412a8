"""A rate that does not drift, and histograms that do not grow."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from tsjepa.live import timing
from tsjepa.live.timing import OLDEST, Ages, Durations, Metronome


@pytest.fixture
def clock(monkeypatch):
    """Virtual time that passes only where somebody sleeps or works."""
    clock = SimpleNamespace(now=50.0)

    async def sleep(seconds):
        clock.now += seconds

    monkeypatch.setattr(timing, "time", SimpleNamespace(monotonic=lambda: clock.now, perf_counter=lambda: clock.now))
    monkeypatch.setattr(timing, "asyncio", SimpleNamespace(sleep=sleep, Event=asyncio.Event))
    return clock


def slots(clock, work: dict[int, float], count: int) -> tuple[list[int], list[float], Metronome]:
    """Which slots came and when, where some take long."""
    metronome, seen = Metronome(0.02), []

    async def run():
        async for slot in metronome.slots(count, asyncio.Event()):
            seen.append((slot, clock.now - 50.0))
            clock.now += work.get(slot, 0.005)

    asyncio.run(run())
    return [slot for slot, _ in seen], [when for _, when in seen], metronome


def test_slots_begin_at_multiples_of_the_period(clock):
    numbers, times, metronome = slots(clock, {}, 1000)
    assert numbers == list(range(1000))
    np.testing.assert_allclose(times, 0.02 * np.arange(1000), atol=1e-9)
    assert metronome.missed == 0


def test_a_slot_that_takes_longer_delays_the_next_one_and_no_other(clock):
    numbers, times, metronome = slots(clock, {3: 0.025}, 6)
    assert numbers == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(times, [0, 0.02, 0.04, 0.06, 0.085, 0.1], atol=1e-9)
    assert metronome.missed == 0


def test_slots_that_have_passed_are_left_out_and_counted(clock):
    numbers, times, metronome = slots(clock, {2: 0.095}, 10)
    assert numbers == [0, 1, 2, 6, 7, 8, 9]  # 2 lasts until the middle of 6
    assert times[3:] == pytest.approx([0.135, 0.14, 0.16, 0.18])
    assert metronome.missed == 3


def test_the_metronome_stops_when_it_is_told():
    async def run():
        stop, seen = asyncio.Event(), []
        async for slot in Metronome(1e-4).slots(None, stop):
            seen.append(slot)
            if len(seen) == 3:
                stop.set()
        return seen

    assert len(asyncio.run(run())) == 3


def test_quantiles_are_those_of_the_durations_to_a_bar():
    durations, drawn = Durations(), np.random.default_rng(0).exponential(3e-3, 5000)
    for seconds in drawn:
        durations.add(seconds)
    for share in (0.1, 0.5, 0.9, 0.99):
        exact = np.quantile(drawn, share)
        assert exact * 0.99 <= durations.quantile(share) <= exact * 1.13
    summary = durations.summary()
    assert summary["count"] == 5000
    assert summary["max_ms"] == pytest.approx(1e3 * drawn.max(), abs=1e-3)
    assert summary["mean_ms"] == pytest.approx(1e3 * drawn.mean(), abs=1e-3)


def test_any_duration_has_a_bar():
    durations = Durations()
    for seconds in (0.0, 1e-9, 1e-6, 10.0, 1e5):
        durations.add(seconds)
    assert durations.bars.sum() == 5
    assert durations.quantile(1.0) == 1e5 or durations.quantile(1.0) <= 12
    assert Durations().summary() == {"count": 0, "mean_ms": 0, "p50_ms": 0, "p99_ms": 0, "max_ms": 0}


def test_ages_are_counted_up_to_the_last_bar():
    ages = Ages()
    ages.add(np.array([1, 1, 5, OLDEST, 10**6]))
    assert ages.summary() == {"1": 2, "5": 1, str(OLDEST): 2}
