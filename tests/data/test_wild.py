"""Public recordings that nobody of this project made: what ``inspect`` and ``import`` say about each."""

import json

import numpy as np
import pytest
from recordings import wild

from tsjepa.cli import main
from tsjepa.data.inspect import inspect_recording
from tsjepa.data.readers import open_recording
from tsjepa.data.storage import open_split, read_metadata

pytestmark = pytest.mark.slow  # every test starts a process, trains or closes loops


def imported(part, folder, *options):
    """Report, metadata and splits of an import through the command line."""
    assert main(["import", str(wild(part)), str(folder), *options]) == 0
    metadata = read_metadata(folder)
    splits = {name: open_split(folder, name) for name in metadata["splits"]}
    return json.loads((folder / "import.json").read_text()), metadata, splits


@pytest.mark.slow
def test_the_arm_has_five_episodes_and_a_clock_one_frame_ahead(tmp_path):
    report, metadata, splits = imported("recordings/arm-lerobot-v20", tmp_path / "set")
    assert report["format"] == "LeRobot v2.0" and report["episodes"] == 5
    assert report["offset_s"] == pytest.approx(0.05, abs=1e-3)
    notes = " ".join(report["notes"])
    assert "+1.0 frames" in notes
    assert "observation.images.egoview ([800, 1280, 3]) is declared and has no file" in notes
    assert "data_path does not lead to the file of 4 of 5 episodes (1-4)" in notes
    assert "total_videos is 2; 5 are there" in notes and "split train is 0:100" in notes
    assert report["skipped"] == []
    assert sum(len(split) for split in splits.values()) == 24  # 5 + 5 + 5 + 5 + 4 of 100 slots
    assert metadata["spec"]["frame"] == [64, 64] and len(metadata["spec"]["action_names"]) == 44
    assert metadata["spec"]["slot"] == pytest.approx(0.05)


@pytest.mark.slow
def test_the_humanoid_has_one_episode_whose_state_follows_by_nine_slots(tmp_path):
    report, _, _ = imported("recordings/humanoid-lerobot-v21", tmp_path / "set")
    assert report["format"] == "LeRobot v2.1" and report["episodes"] == 1
    assert report["lag_slots"][0] == 9 and any("by about 9 slots" in note for note in report["notes"])
    assert [(entry["name"], entry["count"]) for entry in report["skipped"]] == [
        ("episode 30", 1),
        ("episodes 0-28, 31-99", 98),
    ]
    assert "no video of observation.images.cam_high" in report["skipped"][0]["reason"]


def test_the_humanoids_nested_names_are_flat():
    (episode, *_) = open_recording(wild("recordings/humanoid-lerobot-v21")).episodes()
    assert episode.action_names[0] == "kLeftShoulderPitch" and len(episode.action_names) == 26


@pytest.mark.slow
def test_the_car_is_split_at_its_gaps_and_its_missing_catalogs_are_named(tmp_path):
    report, metadata, splits = imported("recordings/car-tub", tmp_path / "set")
    assert report["format"] == "Donkeycar tub v2"
    assert any("2 gaps of 11.3 s, 82.0 s split it" in note for note in report["notes"])
    skipped = [entry["name"] for entry in report["skipped"]]
    assert [name for name in skipped if "catalog" in name] == [f"catalog_{number}.catalog" for number in range(1, 6)]
    assert any("piece 0" in name for name in skipped)  # two records before the first gap
    assert metadata["spec"]["action_names"] == ["user/angle", "user/throttle"]
    assert metadata["spec"]["slot"] == pytest.approx(0.05, abs=1e-3)
    assert sum(len(split) for split in splits.values()) == 11  # of 579 and 421 records, stretches that share no picture


@pytest.mark.slow
def test_the_cart_pole_that_lerobot_wrote(tmp_path):
    report, metadata, splits = imported("recordings/cartpole-lerobot-v30", tmp_path / "set", "--size", "null")
    assert report["format"] == "LeRobot v3.0" and report["episodes"] == 4 and report["skipped"] == []
    assert metadata["spec"]["action_names"] == ["force_n"] and metadata["spec"]["action_units"] == ["N"]
    assert metadata["spec"]["state_units"] == ["m", "rad", "m/s", "rad/s"]
    assert metadata["spec"]["frame"] == [64, 128] and metadata["spec"]["action_low"] == [-20.0]
    assert any("av1 yuv420p" in note for note in report["notes"])
    action = np.concatenate([split["action"].numpy() for split in splits.values()])
    pq = pytest.importorskip("pyarrow.parquet")
    rows = pq.read_table(wild("recordings/cartpole-lerobot-v30") / "data/chunk-000/file-000.parquet")
    recorded = rows["action"].to_numpy().reshape(4, 101)
    assert {row.tobytes() for row in action[:, :-1, 0]} == {row.tobytes() for row in recorded[:, :-1]}


@pytest.mark.parametrize(
    ("part", "sentence"),
    [
        ("recordings/lookalike", "holds 2 recordings (dataset, examples/dataset): name one of them"),
        ("recordings/lookalike/dataset", "no rows (no Parquet file under data/), and its info.json names no version"),
        ("recordings/lookalike/examples/dataset", "no rows (no Parquet file under data/)"),
        ("recordings/pointers", "Git LFS pointer, not the data"),
        ("recordings/empty-arrays-hdf5", "every array is of length zero"),
    ],
)
@pytest.mark.parametrize("command", ["inspect", "import"])
def test_what_cannot_be_used_is_refused_in_one_sentence(part, sentence, command, tmp_path, capsys):
    words = [command, str(wild(part))] + ([str(tmp_path / "set")] if command == "import" else [])
    assert main(words) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_inspect_lists_streams_with_measured_and_claimed_rates(capsys):
    result = inspect_recording(str(wild("recordings/arm-lerobot-v20")))
    pixels, action, state = result["streams"]
    assert "next.reward" in result["others"] and pixels["coding"] == "h264 yuv420p"
    assert pixels["shape"] == [256, 256, 3] and pixels["rate_hz"] == pytest.approx(20) and pixels["claimed_hz"] == 20
    assert sum(column["constant"] for column in action["columns"]) == 25
    assert sum(column["constant"] for column in state["columns"]) == 18
    assert result["command"].startswith("tsjepa import ")
    assert "5 episodes that can be read" in capsys.readouterr().out
