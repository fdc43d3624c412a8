"""What a device that remembers is told of the slot before: its belief, and the command that moved its machine."""

from types import SimpleNamespace

import numpy as np
import pytest
from world import Graphs, Machine

from tsjepa.live import device_loop
from tsjepa.live.device_loop import Device
from tsjepa.live.seal import Seal

REST = 0.0


class Remembering(Graphs):
    """Its belief is the number that it sees; it notes the belief and the command that it was given."""

    belief_dim = 1

    def __init__(self, takes_s: float = 0.0) -> None:
        self.given, self.takes_s, self.now = [], takes_s, 0.0

    def observe(self, frames, belief, command):
        self.given.append((int(frames[0, 0]), float(belief[0, 0]), float(command[0, 0])))
        self.now += self.takes_s
        return frames.astype(np.uint8), frames[:, :1].astype(np.float32)


class Shown(Machine):
    """Shows 1, 2, ... in turn, after -1 in the warm-up; begins an episode after ``lasts`` steps."""

    def __init__(self, at_once: bool, lasts: int = 1000) -> None:
        super().__init__()
        self.at_once, self.lasts, self.looks = at_once, lasts, 0

    def earlier(self):
        return [np.full((1, 2), -1)]

    def look(self):
        self.looks += 1
        return np.full((1, 2), self.looks)

    def act(self, commands):
        super().act(commands)
        return not self.at_once and len(self.applied) % self.lasts == 0


@pytest.fixture
def make(monkeypatch):
    """A device whose command of slot k is 10 + k, in time that passes only while it encodes."""

    def device(machine, graphs, **options) -> Device:
        clock = SimpleNamespace(monotonic=lambda: graphs.now, perf_counter=lambda: graphs.now)
        monkeypatch.setattr(device_loop, "time", clock)
        made = Device(graphs, machine, [0], ("127.0.0.1", 9), Seal(), **options)
        monkeypatch.setattr(made, "commands", lambda: np.float32([[10.0 + made.slot]]))
        monkeypatch.setattr(made, "send", lambda number, payload: None)
        made.metronome.started = 0.0
        return made

    return device


@pytest.mark.parametrize("at_once", [True, False])
def test_it_corrects_by_the_command_of_the_slot_before(make, at_once):
    graphs = Remembering()
    device = make(Shown(at_once), graphs)
    for slot in range(4):
        device.tick(slot)
        device.begin_slot()
    warm_up = (-1, 0.0, REST)
    assert graphs.given == [warm_up, (1, -1.0, REST), (2, 1.0, 10.0), (3, 2.0, 11.0), (4, 3.0, 12.0)]


@pytest.mark.parametrize("at_once", [True, False])
def test_a_belief_from_before_skipped_slots_is_dropped(make, at_once):
    graphs = Remembering()
    device = make(Shown(at_once), graphs)
    for slot in (0, 1, 4, 5):
        device.tick(slot)
        device.begin_slot()
    assert [belief for _, belief, _ in graphs.given] == [0.0, -1.0, 1.0, 0.0, 3.0]


def test_an_episode_begins_with_a_belief_of_its_own_warm_up(make):
    graphs = Remembering()
    device = make(Shown(at_once=False, lasts=2), graphs)
    for slot in range(4):
        device.tick(slot)
        device.begin_slot()
    warm_up = (-1, 0.0, REST)
    assert graphs.given == [warm_up, (1, -1.0, REST), (2, 1.0, 10.0), warm_up, (3, -1.0, REST), (4, 3.0, 12.0)]


@pytest.mark.parametrize(("takes_s", "late"), [(0.001, 0), (0.03, 4)])
def test_a_slot_without_an_update_is_late_as_well(make, takes_s, late):
    graphs = Remembering(takes_s)
    device = make(Shown(at_once=True), graphs, period=5)
    for slot in range(4):
        device.tick(slot)
        graphs.now = device.metronome.begins(slot)
        device.begin_slot()
    assert device.late == late
