"""``--record`` of a device and of its controller: the files say what both did, as Rerun's own reader reads them."""

import numpy as np
import pytest
from world import Graphs, Machine, World

pytest.importorskip("rerun", reason="needs tsjepa[record]")

from recorded_file import RecordedFile

from tsjepa.live.recorded import recorded
from tsjepa.support.spec import PlantSpec

SPEC = PlantSpec((-20.0,), (20.0,), slot=0.02, frame=(4, 6), state_names=("place",), state_units=("m",))
LOST = 3


class Filmed(Machine):
    """Its pictures are as bright as its number of slots; its state is that number in tenths."""

    def look(self):
        return np.full((self.devices, 2, 4, 6, 3), len(self.applied), np.uint8)

    @property
    def state(self):
        return np.full((self.devices, 1), 0.1 * len(self.applied))


class BrightnessGraphs(Graphs):
    def encode(self, frames):
        return frames[:, :, 0, 0, 0]


class LosesOne:
    def delay(self, device, episode, slot):
        return np.inf if slot == LOST else 0.0


def test_the_files_of_both_ends_say_what_they_did(monkeypatch, tmp_path):
    world = World(monkeypatch)
    with recorded(tmp_path / "c.rrd", SPEC, [0]) as write, recorded(tmp_path / "d.rrd", SPEC, [0]) as write_device:
        world.control(graphs=BrightnessGraphs()).record = write
        machine = Filmed()
        world.device(machine, graphs=BrightnessGraphs(), weather=LosesOne(), record=write_device)
        world.run(8)
    world.close()
    device, controller = (RecordedFile(tmp_path / name) for name in ("d.rrd", "c.rrd"))
    seconds, pictures = device.pictures("/device\\ 0/camera")
    assert seconds == pytest.approx(0.02 * np.arange(8))
    assert pictures.shape == (8, 4, 6, 3)
    assert np.abs(pictures[:, 0, 0, 0].astype(int) - np.arange(8)).max() == 0
    assert device.numbers("/device\\ 0/state")[1][:, 0] == pytest.approx(0.1 * np.arange(8))
    assert device.numbers("/device\\ 0/command")[1][:, 0] == pytest.approx([row[0] for row in machine.applied])
    sent, delivered = device.numbers("/device\\ 0/radio")[1].T
    assert sent.tolist() == [1] * 8
    assert delivered.tolist() == [slot != LOST for slot in range(8)]
    seconds, ages = controller.numbers("/device\\ 0/age")
    assert seconds == pytest.approx(0.02 * np.arange(8))
    assert ages[:, 0].tolist() == [2 if slot == LOST else 1 for slot in range(8)]


def test_nothing_is_written_unless_it_is_wanted(tmp_path):
    with recorded(None, SPEC, [0]) as write:
        assert write is None
    with pytest.raises(ValueError, match=r"must name a file that ends in \.rrd"), recorded("live.mp4", SPEC, [0]):
        pass
