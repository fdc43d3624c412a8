"""What is written into a recording comes back from Rerun's own reader."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs tsjepa[record]")

from recorded_file import RecordedFile

from tsjepa.plants import CartPole
from tsjepa.support.recording import arrange, check_recording, introduce, record_slot, recording

SPEC = CartPole().spec
NAME, PATH = "max_age/device 3", "/max_age/device\\ 3"


@pytest.fixture(scope="module")
def frames():
    return np.random.default_rng(0).integers(0, 256, (4, 64, 128, 3), np.uint8)


@pytest.fixture(scope="module")
def written(tmp_path_factory, frames):
    path = tmp_path_factory.mktemp("recording") / "new folder" / "run.rrd"
    with recording(path) as stream:
        arrange(stream, {"max_age": [NAME]}, believes=True)
        introduce(stream, NAME, SPEC)
        for slot, frame in enumerate(frames):
            pictures = {"camera": frame} if slot else {"camera": frame, "belief": frame[::-1]}
            numbers = {"state": [slot, 1, 2, 3], "command": [-slot], "age": slot + 1, "radio": [True, slot == 2]}
            record_slot(stream, NAME, slot * SPEC.slot, pictures, numbers)
    return path


def test_pictures_come_back_without_loss_at_their_times(written, frames):
    seconds, pictures = RecordedFile(written).pictures(f"{PATH}/camera")
    assert seconds == pytest.approx([0, 0.02, 0.04, 0.06])
    assert np.array_equal(pictures, frames)
    seconds, pictures = RecordedFile(written).pictures(f"{PATH}/belief")
    assert seconds == pytest.approx([0])
    assert np.array_equal(pictures[0], frames[0][::-1])


def test_numbers_come_back_with_the_names_of_the_plant(written):
    file = RecordedFile(written)
    assert file.numbers(f"{PATH}/state")[1].tolist() == [[slot, 1, 2, 3] for slot in range(4)]
    assert file.numbers(f"{PATH}/command")[1].tolist() == [[0], [-1], [-2], [-3]]
    assert file.numbers(f"{PATH}/age")[1].tolist() == [[1], [2], [3], [4]]
    assert file.numbers(f"{PATH}/radio")[1].tolist() == [[1, 0], [1, 0], [1, 1], [1, 0]]
    assert file.names(f"{PATH}/state") == ["x [m]", "theta [rad]", "x_dot [m/s]", "theta_dot [rad/s]"]
    assert len(file.names(f"{PATH}/command")) == SPEC.action_dim


def test_everything_lies_on_one_timeline_and_the_file_brings_its_layout(written):
    file = RecordedFile(written)
    assert file.timelines() == {"time"}
    assert file.blueprints == 1
    assert [path.name for path in written.parent.iterdir()] == ["run.rrd"]


@pytest.mark.slow
def test_reruns_own_program_verifies_the_file(written):
    program = Path(sys.executable).with_name("rerun")
    done = subprocess.run([program, "rrd", "verify", str(written)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_files_of_one_recording_id_are_one_recording(tmp_path):
    for name in ("device", "controller"):
        with recording(tmp_path / f"{name}.rrd", "live"):
            pass
    from rerun.chunk import RrdReader

    ids = {RrdReader(tmp_path / f"{name}.rrd").recordings()[0].recording_id for name in ("device", "controller")}
    assert ids == {"live"}


def test_a_block_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "run.rrd"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), recording(path):
        raise ZeroDivisionError
    assert path.read_bytes() == b"old"


def test_what_cannot_be_recorded_is_said_before(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"must name a file that ends in \.rrd"):
        check_recording("run.mp4")
    (tmp_path / "file").touch()
    with pytest.raises(OSError), recording(tmp_path / "file" / "run.rrd"):
        pass
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'tsjepa\[record\]'"):
        check_recording("run.rrd")
