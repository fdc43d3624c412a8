"""Import: what reaches the data set, bit by bit, and what is left out, named and counted."""

import json
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import recordings as make

from tsjepa import cli
from tsjepa.data.cutting import starts
from tsjepa.data.exporter import export_data
from tsjepa.data.import_plan import merge_notes, plan_import
from tsjepa.data.importer import import_recording, resize
from tsjepa.data.inspect import inspect_recording
from tsjepa.data.readers import Episode
from tsjepa.data.readers.pictures import ArrayPictures
from tsjepa.data.report import lag_note
from tsjepa.data.storage import open_split, read_metadata


def run(path, folder, **options):
    """Imports with short trajectories at the recording's own size; returns metadata, report and all trajectories."""
    import_recording(str(path), str(folder), **{"size": None, "slots": 4, **options})
    metadata = read_metadata(folder)
    splits = {name: open_split(folder, name) for name in metadata["splits"]}
    return metadata, json.loads((folder / "import.json").read_text()), splits


def frame_numbers(pixels):
    """Which picture of recordings.pictures each is, from its first pixel."""
    return pixels[..., 0, 0, 0].long() + 256 * pixels[..., 0, 0, 1].long()


def test_trajectories_hold_the_recordings_bits(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [13, 9, 10])
    metadata, report, splits = run(path, tmp_path / "set")
    assert {name: split.shape[0] for name, split in splits.items()} == {
        name: entry["episodes"] for name, entry in metadata["splits"].items()
    }
    seen = set()
    for split in splits.values():
        numbers = frame_numbers(split["pixels"])
        for trajectory in range(len(split)):
            episode, first = divmod(int(numbers[trajectory, 0]), 100)
            seen.add((episode, first))
            rows = slice(first, first + 5)
            np.testing.assert_array_equal(split["pixels"][trajectory], make.pictures(5, first=100 * episode + first))
            length = [13, 9, 10][episode]
            np.testing.assert_array_equal(
                split["action"][trajectory][:-1], make.commands(length, 2, episode)[rows][:-1]
            )
            assert (split["action"][trajectory][-1] == 0).all()
            np.testing.assert_array_equal(split["state"][trajectory], make.commands(length, 3, 100 + episode)[rows])
    assert seen == {(0, 0), (0, 4), (0, 8), (1, 0), (1, 4), (2, 0), (2, 4), (2, 5)}
    assert report["skipped"] == [] and report["episodes"] == 3
    assert (tmp_path / "set" / "contact_sheet.png").is_file()


def test_the_specification_is_the_recordings_own(tmp_path):
    metadata, _, _ = run(make.lerobot_v2(tmp_path / "recording", [13, 9, 10]), tmp_path / "set")
    spec = metadata["spec"]
    all_commands = np.concatenate([make.commands(length, 2, seed)[:-1] for seed, length in enumerate([13, 9, 10])])
    assert spec["action_names"] == ["left_n", "right_n"] and spec["action_units"] == ["N", "N"]
    assert spec["state_names"] == ["x_m", "v_m_s", "angle"] and spec["state_units"] == ["m", "m/s", "unknown"]
    np.testing.assert_allclose(spec["action_low"], all_commands.min(0), rtol=1e-6)
    np.testing.assert_allclose(spec["action_high"], all_commands.max(0), rtol=1e-6)
    assert spec["frame"] == [16, 24] and spec["slot"] == pytest.approx(0.05)
    assert metadata["made_by"] == "tsjepa import"


def test_episodes_are_held_out_whole(tmp_path):
    _, _, splits = run(make.lerobot_v2(tmp_path / "recording", [9] * 6), tmp_path / "set", validation=0.2, test=0.2)
    episodes = {name: set((frame_numbers(split["pixels"]) // 100).flatten().tolist()) for name, split in splits.items()}
    assert {name: len(held) for name, held in episodes.items()} == {"train": 4, "validation": 1, "test": 1}
    assert not episodes["train"] & episodes["test"] and not episodes["train"] & episodes["validation"]


def test_one_episode_is_held_out_by_stretches_that_share_no_picture(tmp_path):
    _, _, splits = run(make.lerobot_v2(tmp_path / "recording", [33]), tmp_path / "set")
    numbers = {name: set(frame_numbers(split["pixels"]).flatten().tolist()) for name, split in splits.items()}
    assert set().union(*numbers.values()) == set(range(33))
    assert sum(map(len, numbers.values())) == 33
    assert max(numbers["train"]) < min(numbers["validation"]) and max(numbers["validation"]) < min(numbers["test"])


def test_a_cut_covers_every_picture():
    for frames in range(5, 40):
        covered = {first + place for first in starts(frames, 4) for place in range(5)}
        assert covered == set(range(frames))
        assert max(starts(frames, 4)) + 5 == frames


def test_short_episodes_are_skipped_named_and_counted(tmp_path):
    _, report, splits = run(make.lerobot_v2(tmp_path / "recording", [9, 3, 9]), tmp_path / "set")
    assert [entry["name"] for entry in report["skipped"]] == ["episode 1"] and report["episodes"] == 2
    assert "3 pictures are too few for 4 slots" in report["skipped"][0]["reason"]
    assert sum(len(split) for split in splits.values()) == 4


def test_strict_refuses_and_leaves_nothing(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [9, 3, 9])
    with pytest.raises(ValueError, match=r"episode 1.*strict"):
        run(path, tmp_path / "set", strict=True)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["recording"]


def test_nothing_long_enough_says_which_slots_would_do(tmp_path):
    with pytest.raises(ValueError, match=r"longest piece has 9 pictures.*--slots 8"):
        run(make.lerobot_v2(tmp_path / "recording", [9]), tmp_path / "set", slots=100)


def test_a_seed_below_zero_is_refused_before_pictures_are_read(tmp_path):
    with pytest.raises(ValueError, match="seed is -1"):
        run(tmp_path / "recording", tmp_path / "set", seed=-1)


def test_pictures_that_cannot_be_decoded_end_an_episode_and_the_rest_is_imported(tmp_path):
    path = make.numbered_pictures(tmp_path / "recording", 14)
    (path / "frame11.png").write_bytes(b"no picture")
    _, report, splits = run(path, tmp_path / "set", validation=0, test=0)
    assert report["skipped"][0]["name"].endswith("from picture 10 on") or "frame11" in report["skipped"][0]["reason"]
    assert frame_numbers(splits["train"]["pixels"]).max() == 9


def test_an_episode_whose_pictures_never_change_is_skipped(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [9, 9, 9])
    still = np.repeat(make.pictures(1), 9, axis=0)
    make.write_video(path / "videos/chunk-000/observation.images.front/episode_000001.mp4", still)
    metadata, report, _ = run(path, tmp_path / "set")
    assert report["skipped"] == [{"name": "episode 1", "reason": "its 9 pictures are all the same.", "count": 1}]
    used = np.concatenate([make.commands(9, 2, seed)[:-1] for seed in (0, 2)])  # and its commands are not counted
    np.testing.assert_allclose(metadata["spec"]["action_high"], used.max(axis=0), rtol=1e-6)


def test_identical_pictures_in_a_row_are_counted(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [9, 9])
    frames = make.pictures(9)
    frames[3:5] = frames[2]
    make.write_video(path / "videos/chunk-000/observation.images.front/episode_000000.mp4", frames)
    _, report, _ = run(path, tmp_path / "set")
    assert "2 of 18 pictures are the same as the one before." in report["notes"]


def test_mixed_frame_rates_are_said_and_resampled(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [21, 21])
    make.write_video(
        path / "videos/chunk-000/observation.images.front/episode_000001.mp4", make.pictures(21, first=100), 10
    )
    rows = {"action": make.commands(21), "observation.state": make.commands(21, 3), "timestamp": np.arange(21) / 10,
            "episode_index": np.ones(21, np.int64)}  # fmt: skip
    make.write_parquet(path / "data/chunk-000/episode_000001.parquet", rows)
    _, report, splits = run(path, tmp_path / "set", slot=0.05, validation=0, test=0)
    assert any("frame rates are mixed, 10 to 20 a second" in note for note in report["notes"])
    numbers = frame_numbers(splits["train"]["pixels"])
    slow = sorted({int(number) for row in numbers for number in row if number >= 100})
    assert slow == list(range(100, 121))
    held = next(row for row in numbers if row[0] == 100)
    assert held.tolist() == [100, 100, 101, 101, 102]


def test_a_wrong_claimed_rate_is_said_and_the_measured_one_taken(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [9, 9])
    info = json.loads((path / "meta/info.json").read_text())
    (path / "meta/info.json").write_text(json.dumps({**info, "fps": 50}))
    metadata, report, _ = run(path, tmp_path / "set")
    assert metadata["spec"]["slot"] == pytest.approx(0.05)
    assert "50 pictures a second are claimed; 20 are measured." in report["notes"]


def test_columns_in_another_order_are_put_in_order(tmp_path):
    path = make.videos_and_csv(tmp_path / "recording", [9, 9])
    for episode, names in enumerate((("action_a", "action_b"), ("action_b", "action_a"))):
        columns = {"time_s": [k / 20 for k in range(9)]}
        columns |= {name: [(1 if name == "action_a" else 2) + k / 10 for k in range(9)] for name in names}
        make.write_csv(path / f"run_{episode}.csv", columns)
    metadata, report, splits = run(path, tmp_path / "set", validation=0, test=0)
    assert metadata["spec"]["action_names"] == ["action_a", "action_b"]
    assert (splits["train"]["action"][:, 0, 0] < splits["train"]["action"][:, 0, 1]).all()
    assert any("another order" in note for note in report["notes"])


def test_other_columns_are_named_and_left_out(tmp_path):
    path = make.videos_and_csv(tmp_path / "recording", [9, 9])
    make.write_csv(path / "run_1.csv", {"time_s": [k / 20 for k in range(9)], "command": range(9)})
    _, report, _ = run(path, tmp_path / "set")
    assert (
        report["skipped"][0]["name"] == "run_1.mp4"
        and "the first episode has action(N)" in report["skipped"][0]["reason"]
    )


def test_constant_columns_are_named(tmp_path):
    path = make.videos_and_csv(tmp_path / "recording", [9, 9])
    for episode in range(2):
        make.write_csv(
            path / f"run_{episode}.csv",
            {"time_s": [k / 20 for k in range(9)], "action_x": range(9), "action_y": [3] * 9},
        )
    metadata, report, _ = run(path, tmp_path / "set")
    assert "1 of 2 columns of the action are constant (action_y)." in report["notes"]
    assert (metadata["spec"]["action_low"], metadata["spec"]["action_high"]) == ([0, 2.5], [7, 3.5])


def test_a_gap_splits_a_tub(tmp_path):
    times = np.concatenate([np.arange(8), 300 + np.arange(9)]) / 20
    _, report, splits = run(make.donkeycar(tmp_path / "tub", times, catalogs=2), tmp_path / "set", validation=0, test=0)
    assert sum(len(split) for split in splits.values()) == 4
    assert any("1 gaps of 14.7 s split it" in note or "1 gaps of 14.6 s split it" in note for note in report["notes"])
    assert report["skipped"][0]["name"] == "catalog_1.catalog"


def test_pictures_are_made_smaller_by_the_mean_of_what_they_cover():
    picture = np.random.default_rng(0).integers(0, 256, (16, 24, 3), dtype=np.uint8)
    means = picture.reshape(8, 2, 8, 3, 3).astype(float).mean(axis=(1, 3))
    np.testing.assert_allclose(resize(picture, 8, 8), means, atol=1)
    assert resize(picture, 16, 24) is picture


def test_a_data_set_that_is_there_is_kept(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [9, 9])
    run(path, tmp_path / "set")
    before = (tmp_path / "set" / "metadata.json").read_bytes()
    with pytest.raises(FileExistsError, match="--overwrite true"):
        run(path, tmp_path / "set", slots=3)
    assert (tmp_path / "set" / "metadata.json").read_bytes() == before
    assert run(path, tmp_path / "set", slots=3, overwrite=True)[0]["slots"] == 3


def test_no_picture_is_kept_longer_than_its_block(tmp_path, monkeypatch):
    """Of a recording larger than memory only a block of pictures is ever decoded at a time."""
    import tsjepa.data.importer as importer
    from tsjepa.data.readers.video import Video

    asked = []
    read = Video.read
    monkeypatch.setattr(Video, "read", lambda self, indices: asked.append(len(indices)) or read(self, indices))
    monkeypatch.setattr(importer, "BLOCK_BYTES", 3 * 16 * 24 * 3)
    run(make.lerobot_v2(tmp_path / "recording", [13, 9]), tmp_path / "set")
    assert max(asked) == 3 and sum(asked) == 22


def test_the_same_note_of_several_episodes_is_one_sentence():
    assert merge_notes(["a: x.", "y.", "b: x.", "c: x.", "d: x."]) == ["a, b, c and 1 more: x.", "y."]


@pytest.mark.parametrize("rate_hz", [20, 100, 1000])
def test_the_lag_is_told_in_slots_however_fast_the_rows_come(rate_hz):
    """A state that follows its command by 0.2 s, beside pictures at 20 Hz."""
    count, lag = 8 * rate_hz, rate_hz // 5
    command = np.cumsum(np.random.default_rng(0).normal(size=(count, 3)), axis=0).astype(np.float32)
    state = np.concatenate([np.repeat(command[:1], lag, axis=0), command[:-lag]])
    pictures = ArrayPictures(make.pictures(160), times=np.arange(160) / 20)
    names, units = ["a", "b", "c"], ["rad"] * 3
    episode = Episode("one", pictures, command, names, units, state, names, units, np.arange(count) / rate_hz)
    recording = SimpleNamespace(rate_hz=None, notes=[], episodes=lambda: iter([episode]))
    assert plan_import(recording).lag == (4, 4, 4)
    plan = plan_import(recording, slot=0.1)
    assert plan.lag == (2, 2, 2) and "by about 2 slots" in lag_note(plan)
    drawn = np.random.default_rng(1).normal(size=state.shape).astype(np.float32)
    others = [replace(episode, name=name, state=drawn) for name in ("two", "three")]
    recording.episodes = lambda: iter([episode, *others])
    assert plan_import(recording).lag is None  # one episode of three


def test_inspect_says_what_import_does_and_names_the_command(tmp_path, capsys):
    path = make.lerobot_v2(tmp_path / "recording", [9, 3, 9])
    result = inspect_recording(str(path))
    text = capsys.readouterr().out
    assert "LeRobot v2.1" in text and "episode 1: 3 pictures, 3 rows, 20 Hz" in text
    assert "left_n [N]: " in text and "pixels: [16, 24, 3]" in text
    assert result["command"] == f"tsjepa import {path} data/recording --slots 8"
    assert cli.main(["inspect", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(result))


def test_an_episode_whose_state_is_never_finite_is_named_and_left_out(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [9, 9])
    rows = {"action": make.commands(9), "observation.state": np.full((9, 3), np.nan, np.float32),
            "timestamp": np.arange(9) / 20, "episode_index": np.ones(9, np.int64)}  # fmt: skip
    make.write_parquet(path / "data/chunk-000/episode_000001.parquet", rows)
    _, report, splits = run(path, tmp_path / "set")
    assert [entry["name"] for entry in report["skipped"]] == ["episode 1"]
    assert "its state has the columns none" in report["skipped"][0]["reason"]
    assert all(split["state"].isfinite().all() for split in splits.values())


def test_the_last_command_of_an_environments_recorder_is_not_missed(tmp_path):
    """N pictures whose last command is NaN are N - 1 steps, all of which are kept."""
    _, report, splits = run(
        make.stable_worldmodel(tmp_path / "world.h5", [9]), tmp_path / "set", rate_hz=20, validation=0, test=0
    )
    assert sum(len(split) for split in splits.values()) == 2
    commands = splits["train"]["action"][:, :-1].reshape(-1, 2).numpy()
    np.testing.assert_array_equal(commands, make.commands(9, 2)[:-1])
    assert not any("no finite command" in note for note in report["notes"])


@pytest.mark.slow
def test_import_needs_no_simulator(tmp_path):
    """Whoever has recordings and no plant needs neither mujoco nor dm-control."""
    path = make.videos_and_csv(tmp_path / "recording", [9, 9])
    program = (
        "import sys\n"
        "sys.modules.update(dict.fromkeys(('mujoco', 'dm_control', 'torchrl', 'lightning')))\n"
        "from tsjepa.cli import main\n"
        f"sys.exit(main(['import', {str(path)!r}, {str(tmp_path / 'set')!r}, '--slots', '4']))\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
    assert read_metadata(tmp_path / "set")["slots"] == 4


@pytest.mark.parametrize("there", ["thesis.tex", "drive.mp4"])
def test_overwrite_replaces_a_data_set_and_nothing_else(tmp_path, there):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / there).write_text("mine")
    recording = make.lerobot_v2(tmp_path / "recording", [9, 9])
    for folder in (tmp_path / "home", recording):  # which may be what is read
        with pytest.raises(FileExistsError, match="is there and is no data set: choose a folder"):
            run(recording, folder, overwrite=True)
    assert (tmp_path / "home" / there).read_text() == "mine"
    run(recording, tmp_path / "set")
    run(recording, tmp_path / "set", overwrite=True)
    with pytest.raises(FileExistsError, match="is there and is no LeRobot data set"):
        export_data(str(tmp_path / "set"), str(tmp_path / "set"), overwrite=True)
    assert read_metadata(tmp_path / "set")["made_by"] == "tsjepa import"


@pytest.mark.parametrize(("episodes", "held_out"), [(1, set()), (2, {"validation"}), (3, {"validation", "test"})])
def test_the_first_that_can_be_held_out_is_for_validation(tmp_path, episodes, held_out):
    run(make.lerobot_v2(tmp_path / "recording", [5] * episodes), tmp_path / "set")
    assert set(read_metadata(tmp_path / "set")["splits"]) == {"train"} | held_out
