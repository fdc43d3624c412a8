"""The fleet keeps real time, and runs in a process of its own."""

import time
from dataclasses import replace

import pytest

from tsjepa.envs import Radio
from tsjepa.evaluation.rollouts import Loop
from tsjepa.plants import CartPole
from tsjepa.support.trust import everything_trusted
from tsjepa.watch import process
from tsjepa.watch.process import FORGIVEN_S, Clock, running
from tsjepa.watch.setting import Setting

SLOT = 0.02


class Time:
    """A wall clock that moves when somebody sleeps or works."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now += seconds


@pytest.fixture
def wall(monkeypatch):
    clock = Time()
    monkeypatch.setattr(process, "time", clock)
    return clock


def test_slots_begin_at_their_rate_whatever_a_slot_takes(wall):
    clock = Clock(SLOT)
    for slot in range(1, 1001):
        wall.now += 0.001 * (slot % 19)  # work, always less than a slot
        clock.wait()
        assert wall.now == pytest.approx(100 + slot * SLOT)
    assert clock.pace() == pytest.approx(1)


def test_a_short_delay_is_caught_up(wall):
    clock = Clock(SLOT)
    wall.now += 4 * SLOT
    for _ in range(4):
        clock.wait()
    assert wall.now == pytest.approx(100 + 4 * SLOT)
    clock.wait()
    assert wall.now == pytest.approx(100 + 5 * SLOT)


def test_a_machine_that_is_too_slow_runs_slower_and_says_so(wall):
    clock = Clock(SLOT)
    for _ in range(200):
        wall.now += 2 * SLOT
        clock.wait()
    assert clock.pace() == pytest.approx(0.5)
    begun = wall.now
    while wall.now == begun:  # what it may catch up is bounded
        clock.wait()
        assert len(clock.begun) <= 2 / SLOT
    assert clock.due - wall.now == pytest.approx(SLOT)
    assert wall.now - begun <= SLOT
    assert FORGIVEN_S < 200 * SLOT


@pytest.mark.slow
def test_a_fleet_in_its_own_process_runs_answers_and_ends_with_the_block():
    setting = Setting(devices=3, snr_db=20.0, loss=0.0, scheduler="round_robin", codec="fp32")
    loop = Loop(CartPole(), "linear", slots=2**31, radio=Radio(resource_blocks=1), frame_history=2)
    with running(loop, "linear", setting, 0) as ask:
        first = ask(setting, [])
        assert first.setting == setting
        while (later := ask(setting, [])).slot == first.slot:
            time.sleep(0.01)
        assert ask(replace(setting, devices=5), [4]).setting.devices == 5
        assert later.scenes.shape[0] == 3
    with pytest.raises(OSError):
        ask(setting, [])


OWN = """
from tsjepa.radio import grant

def nearest(known):
    return grant(known.snr, known.candidate, known.demand, known.budget), known.memory
"""


@pytest.mark.slow
def test_a_scheduler_of_ones_own_that_fails_on_the_way_is_named_to_who_asks(tmp_path, monkeypatch):
    """It begins: the other process trusts what this one trusts."""
    late = "def late(known):\n    assert int(known.slot.max()) < 5, 'too late'\n    return nearest(known)\n"
    (tmp_path / "own_late_scheduler.py").write_text(OWN + late)
    monkeypatch.syspath_prepend(tmp_path)
    setting = Setting(devices=3, snr_db=20.0, loss=0.0, scheduler="own_late_scheduler.late", codec="fp32")
    loop = Loop(CartPole(), "linear", slots=2**31, radio=Radio(resource_blocks=1), frame_history=2)
    said = r"own_late_scheduler\.late raised AssertionError: too late"
    with everything_trusted(), running(loop, "linear", setting, 0) as ask, pytest.raises(ValueError, match=said):
        for _ in range(100):
            ask(setting, [])
            time.sleep(0.02)
