"""Tables, videos, pictures and the choice of a reader, against small recordings whose contents are known."""

import json
import os
import resource
import shutil

import cv2
import numpy as np
import pytest
import recordings as make
from reading import read_all, shows

from tsjepa.data.import_plan import plan_import
from tsjepa.data.readers import Streams, open_recording
from tsjepa.data.readers.pictures import ArrayPictures


def test_a_camera_that_is_not_there_is_answered_with_those_that_are(tmp_path):
    with pytest.raises(ValueError, match=r"no camera wrist; the files have observation\.images\.front"):
        open_recording(make.lerobot_v2(tmp_path / "data_set", [12]), Streams(camera="wrist"))


def test_videos_with_tables_of_the_same_name(tmp_path):
    recording, episodes, skipped = read_all(make.videos_and_csv(tmp_path / "runs", [12, 9]))
    assert recording.format == "folder of videos" and not skipped
    for number, (episode, length) in enumerate(zip(episodes, [12, 9], strict=True)):
        shows(episode, first=100 * number)
        np.testing.assert_allclose(episode.action, make.commands(length, 1, seed=number), rtol=1e-6)
        assert (episode.action_names, episode.action_units) == (["action(N)"], ["N"])


@pytest.mark.parametrize("suffix", ["csv", "parquet", "jsonl"])
def test_one_table_for_all_videos(tmp_path, suffix):
    lengths = [12, 9]
    for episode, length in enumerate(lengths):
        make.write_video(tmp_path / f"clip{episode}.mp4", make.pictures(length, first=100 * episode))
    rows = [
        {"video": f"clip{episode}.mp4", "t": k / 20, "cmd": 10.0 * episode + k}
        for episode, length in enumerate(lengths)
        for k in range(length)
    ]
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    if suffix == "jsonl":
        (tmp_path / "rows.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    else:
        (make.write_csv if suffix == "csv" else make.write_parquet)(tmp_path / f"rows.{suffix}", columns)
    _, episodes, skipped = read_all(tmp_path)
    assert not skipped
    shows(episodes[1], first=100)
    np.testing.assert_array_equal(episodes[1].action[:, 0], 10 + np.arange(9, dtype=np.float32))


def test_numbered_pictures_come_2_before_10(tmp_path):
    _, (episode,), _ = read_all(make.numbered_pictures(tmp_path / "frames", 14))
    shows(episode)
    np.testing.assert_allclose(episode.times, np.arange(14) / 20)


def test_commands_that_no_name_gives_away_are_asked_for(tmp_path):
    make.write_video(tmp_path / "a.mp4", make.pictures(8))
    make.write_csv(tmp_path / "a.csv", {"time_ms": [50 * k for k in range(8)], "left": range(8), "right": range(8)})
    _, _, (entry,) = read_all(tmp_path)
    assert "left, right" in entry.reason and "--action" in entry.reason
    _, (episode,), _ = read_all(tmp_path, action=["right", "left"])
    assert episode.action_names == ["right", "left"]
    np.testing.assert_allclose(episode.times, np.arange(8) / 20)


def test_videos_without_commands_are_refused(tmp_path):
    make.write_video(tmp_path / "a.mp4", make.pictures(8))
    with pytest.raises(ValueError, match="1 videos and no table of commands"):
        open_recording(tmp_path)


def test_a_tub_is_read_and_its_missing_catalogs_are_named(tmp_path):
    recording, (episode,), skipped = read_all(make.donkeycar(tmp_path / "tub", np.arange(12) / 20, catalogs=3))
    assert recording.format == "Donkeycar tub v2"
    assert [entry.name for entry in skipped] == ["catalog_1.catalog", "catalog_2.catalog"]
    assert episode.action_names == ["user/angle", "user/throttle"]
    np.testing.assert_allclose(np.diff(episode.times), 0.05, atol=1e-6)
    np.testing.assert_allclose(episode.action, make.commands(12, 2), rtol=1e-6)
    assert episode.frames.read([10])[0, 0, 0, 0] == pytest.approx(7, abs=12)  # JPEG of a picture written as BGR


def test_each_session_of_a_tub_is_an_episode(tmp_path):
    _, episodes, _ = read_all(make.donkeycar(tmp_path / "tub", np.arange(10) / 20, ["a"] * 6 + ["b"] * 4))
    assert [(episode.name, episode.frames.count) for episode in episodes] == [("session a", 6), ("session b", 4)]


def test_a_folder_of_several_recordings_names_them(tmp_path):
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        make.npz(tmp_path / name / "a.npz", 8)
    with pytest.raises(ValueError, match=r"2 recordings \(first, second\): name one"):
        open_recording(tmp_path)


def test_a_folder_of_anything_else_is_refused_in_one_sentence(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(ValueError, match="no recording that is known"):
        open_recording(tmp_path)


class OneFile:
    """A stranger's reader: text files with a command a line and no picture file."""

    format, rate_hz, cameras = "lines", 20.0, ["none"]

    def __init__(self, path, streams):
        self.path, self.notes = path, []

    @staticmethod
    def matches(path):
        return path.suffix == ".txt"

    def episodes(self):
        from tsjepa.data.readers import Episode
        from tsjepa.data.readers.pictures import ArrayPictures

        action = np.loadtxt(self.path, dtype=np.float32, ndmin=2)
        yield Episode("lines", ArrayPictures(make.pictures(len(action))), action, ["u"], ["N"], paired=True)


def test_a_reader_of_a_stranger_by_class_path(tmp_path):
    np.savetxt(tmp_path / "u.txt", make.commands(9, 1))
    recording = open_recording(tmp_path / "u.txt", reader="test_readers.OneFile")
    (episode,) = recording.episodes()
    shows(episode)


def test_pictures_named_by_their_time(tmp_path):
    """Commands at another rate than the pictures, whose names are milliseconds since 1970."""
    for number, frame in enumerate(make.pictures(8)):
        cv2.imwrite(str(tmp_path / f"{1_700_000_000_000 + 50 * number}.png"), frame[..., ::-1])
    stamps = [1_700_000_000_000 + 10 * k for k in range(40)]
    make.write_csv(tmp_path / "rows.csv", {"timestamp_ms": stamps, "action": range(40)})
    _, (episode,), _ = read_all(tmp_path)
    shows(episode)
    np.testing.assert_allclose(np.diff(episode.frames.times), 0.05, atol=1e-6)
    assert episode.times[0] == pytest.approx(episode.frames.times[0])


def test_numbers_of_ten_digits_with_zeros_before_them_are_no_times(tmp_path):
    for number, frame in enumerate(make.pictures(8)):
        cv2.imwrite(str(tmp_path / f"{number:010d}.png"), frame[..., ::-1])
    make.write_csv(tmp_path / "rows.csv", {"time_s": [k / 10 for k in range(8)], "action": range(8)})
    recording, (episode,), _ = read_all(tmp_path)
    shows(episode)
    assert episode.frames.times is None
    assert plan_import(recording).slot == pytest.approx(0.1)


def test_pictures_in_the_order_of_the_rows_that_name_them(tmp_path):
    for number, frame in enumerate(make.pictures(8)):
        cv2.imwrite(str(tmp_path / f"{chr(104 - number)}.png"), frame[..., ::-1])
    names = [f"images/{chr(104 - number)}.png" for number in range(8)]
    dates = [f"2026-01-02 03:04:05.{125 * k:03d}" for k in range(8)]
    make.write_csv(tmp_path / "rows.csv", {"time": dates, "image": names, "action": range(8)})
    _, (episode,), _ = read_all(tmp_path)
    shows(episode)
    np.testing.assert_allclose(episode.times - episode.times[0], np.arange(8) / 8, atol=1e-6)


def test_hundreds_of_episodes_are_not_opened_before_they_are_asked_for(tmp_path, monkeypatch):
    from tsjepa.data.readers import lerobot_v3

    asked = []
    index = lerobot_v3.video_index
    monkeypatch.setattr(lerobot_v3, "video_index", lambda path: asked.append(path) or index(path))
    recording = open_recording(make.lerobot_v3(tmp_path / "data_set", [12, 9]))
    assert not asked
    next(recording.episodes())
    assert len(asked) == 1


def lerobot_with_pictures_in_its_rows(path, episodes):
    """One file an episode, all the same."""
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    make.lerobot_v2(path, [8])
    shutil.rmtree(path / "videos")
    file = path / "data/chunk-000/episode_000000.parquet"
    cells = [cv2.imencode(".png", frame[..., ::-1])[1].tobytes() for frame in make.pictures(8)]
    pq.write_table(pq.read_table(file).append_column("observation.images.front", pa.array(cells)), file)
    for episode in range(1, episodes):
        shutil.copy(file, file.with_name(f"episode_{episode:06d}.parquet"))


def npz_files(path, episodes):
    path.mkdir()
    for episode in range(episodes):
        make.npz(path / f"{episode}.npz", 8)


def hdf5_files(path, episodes):
    make.aloha(path, [8])
    for episode in range(1, episodes):
        shutil.copy(path / "episode_0.hdf5", path / f"episode_{episode}.hdf5")


@pytest.mark.parametrize("write", [npz_files, hdf5_files, lerobot_with_pictures_in_its_rows])
def test_a_recording_may_have_more_episodes_than_files_may_be_open(tmp_path, write):
    write(tmp_path / "recording", 100)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    in_use = {int(number) for number in os.listdir("/dev/fd")}
    last = [number for number in range(1000) if number not in in_use][50]
    resource.setrlimit(resource.RLIMIT_NOFILE, (last, before[1]))
    try:
        _, episodes, skipped = read_all(tmp_path / "recording")
        assert len(episodes) == 100 and not skipped
        for episode in episodes:
            np.testing.assert_array_equal(episode.frames.read([3]), make.pictures(4)[3:])
        shows(episodes[0])
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_several_cameras_are_named_and_one_is_chosen(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = make.aloha(tmp_path / "aloha", [9])
    with h5py.File(path / "episode_0.hdf5", "a") as file:
        file["observations/images/cam_wrist"] = make.pictures(9, first=500)
    recording, (episode,), _ = read_all(path)
    shows(episode)
    high, wrist = "observations/images/cam_high", "observations/images/cam_wrist"
    assert recording.notes == [f"It has the cameras {high}, {wrist}; the first is taken."]
    _, (episode,), _ = read_all(path, camera=wrist)
    shows(episode, first=500)
    _, _, (entry,) = read_all(path, camera="cam_left")
    assert "there is no array cam_left" in entry.reason and wrist in entry.reason


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-0.04, 1.05), (-1.0, 1.0), (0.0, 255.0)])
def test_pictures_of_floats_keep_their_range_where_interpolation_overshoots(low, high):
    pictures = np.linspace(low, high, 64 * 4, dtype=np.float32).reshape(4, 8, 8, 1).repeat(3, -1)
    shown = ArrayPictures(pictures).read(range(4))
    assert (shown.min(), shown.max()) == (0, 255)
    assert len(np.unique(shown)) > 200
