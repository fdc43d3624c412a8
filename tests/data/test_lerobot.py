"""LeRobot itself: a recording of its own writer is imported, and its own reader opens what export-data writes.

LeRobot wants another torch than tsjepa. Where it is not in this environment, ``TSJEPA_LEROBOT_PYTHON`` names the Python
of one that has it (Python 3.12, ``pip install 'lerobot[dataset]==0.6.1'``); without one those tests are skipped.
"""

import functools
import os
import subprocess
import sys
from pathlib import Path

import lerobot_recording as source
import numpy as np
import pytest

from tsjepa.data.exporter import export_data
from tsjepa.data.importer import import_recording
from tsjepa.data.storage import open_split, read_metadata

HERE = Path(__file__).parent
PYTHON = os.environ.get("TSJEPA_LEROBOT_PYTHON", sys.executable)
SLOTS = 37  # an episode of 38 rows is one trajectory, the longer ones are two that overlap
OFFLINE = os.environ | {"HF_HUB_OFFLINE": "1"}  # a data set that does not suit LeRobot is an error, not a download


def in_lerobot(script: str, *words: str) -> None:
    """Runs a script of this folder in the environment that has LeRobot."""
    done = subprocess.run([PYTHON, str(HERE / script), *words], env=OFFLINE, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


@functools.cache
def lerobot_is_there() -> bool:
    return subprocess.run([PYTHON, "-c", "import lerobot.datasets"], capture_output=True).returncode == 0


@pytest.fixture
def needs_lerobot():
    if not lerobot_is_there():
        pytest.skip("LeRobot is not in this environment, and TSJEPA_LEROBOT_PYTHON names none that has it")


def trajectories(folder: Path) -> dict[str, np.ndarray]:
    """Pixels, action and state of a data set in the order of its splits, each [trajectories, rows, ...]."""
    splits = [open_split(folder, name) for name in read_metadata(folder)["splits"]]
    return {key: np.concatenate([split[key].numpy() for split in splits]) for key in ("pixels", "action", "state")}


def assert_imported(recording: Path, folder: Path, version: str) -> None:
    """The data set of the recording holds the commands and states it was made of, and the pictures but for AV1."""
    import_recording(str(recording), str(folder), size=None, slots=SLOTS, validation=0, test=0)
    metadata = read_metadata(folder)
    assert metadata["source"]["format"] == f"LeRobot {version}" and metadata["spec"]["slot"] == pytest.approx(0.05)
    assert metadata["spec"]["action_names"] == ["force_n"] and metadata["spec"]["action_units"] == ["N"]
    got = trajectories(folder)
    starts = [(episode, first) for episode, rows in enumerate(source.LENGTHS) for first in {0, rows - SLOTS - 1}]
    assert len(got["action"]) == len(starts) == 5
    everything = np.concatenate([source.pictures(episode) for episode in range(len(source.LENGTHS))]).astype(int)
    found = set()
    for pixels, action, state in zip(*got.values(), strict=True):
        (place,) = ((episode, first) for episode, first in starts
                    if np.array_equal(action[:-1], source.commands(episode)[first : first + SLOTS]))  # fmt: skip
        episode, first = place
        np.testing.assert_array_equal(state, source.states(episode)[first : first + SLOTS + 1])
        error = np.array([np.abs(picture - everything).mean(axis=(1, 2, 3)) for picture in pixels.astype(int)])
        row = sum(source.LENGTHS[:episode]) + first + np.arange(SLOTS + 1)
        np.testing.assert_array_equal(error.argmin(axis=1), row)  # none is its neighbour
        assert error.min(axis=1).max() < 2
        found.add(place)
    assert found == set(starts)


@pytest.mark.parametrize(("recording", "version"), [("lerobot_0_6_1", "v3.0"), ("lerobot_0_3_3", "v2.1")])
def test_what_lerobots_writer_left_is_imported(recording, version, tmp_path):
    assert_imported(HERE / recording, tmp_path / "set", version)


@pytest.mark.slow
def test_what_the_installed_lerobot_writes_is_imported(needs_lerobot, tmp_path):
    in_lerobot("lerobot_recording.py", str(tmp_path / "recording"))
    assert_imported(tmp_path / "recording", tmp_path / "set", "v3.0")


@pytest.mark.slow
@pytest.mark.parametrize("slot", [0.05, 0.049999])  # 20 and 20.0004 pictures a second; LeRobot compares times to 0.1 ms
@pytest.mark.parametrize(("codec", "most"), [("lossless", 0), ("small", 16)])
def test_lerobots_reader_opens_an_export(needs_lerobot, slot, codec, most, tmp_path):
    options = {"size": None, "slots": SLOTS, "slot": slot, "validation": 0.34, "test": 0}
    import_recording(str(HERE / "lerobot_0_6_1"), str(tmp_path / "set"), **options)
    export_data(str(tmp_path / "set"), str(tmp_path / "export"), task="move the spot", codec=codec)
    in_lerobot("read_by_lerobot.py", str(tmp_path / "export"), str(tmp_path / "rows.npz"))
    ours, theirs = trajectories(tmp_path / "set"), np.load(tmp_path / "rows.npz")
    count, rows = ours["action"].shape[:2]
    assert rows == SLOTS + 1 and count >= 5
    np.testing.assert_array_equal(theirs["action"].reshape(ours["action"].shape), ours["action"])
    np.testing.assert_array_equal(theirs["observation.state"].reshape(ours["state"].shape), ours["state"])
    difference = np.abs(theirs["pixels"].reshape(ours["pixels"].shape).astype(int) - ours["pixels"])
    print(f"LeRobot {theirs['version']}, {codec}, slot {slot}: {count * rows} pictures, largest difference "
          f"{difference.max()} of 255, mean {difference.mean():.2f}")  # fmt: skip
    assert difference.max() <= most and difference.mean() < 1
    np.testing.assert_array_equal(theirs["episode_index"], np.repeat(np.arange(count), rows))
    np.testing.assert_array_equal(theirs["index"], np.arange(count * rows))
    np.testing.assert_allclose(theirs["timestamp"], np.tile(np.arange(rows) * slot, count), rtol=1e-5)
    assert set(theirs["tasks"]) == {"move the spot"}
