"""Every reader against small recordings whose pictures and commands are known."""

import json
import shutil
import zipfile

import cv2
import numpy as np
import pytest
import recordings as make

from tsjepa.data.readers import Skipped, Streams, open_recording
from tsjepa.data.readers.bounded import BoundedPath


def read_all(path, **streams):
    """Episodes and skipped entries of a recording."""
    recording = open_recording(path, Streams(**streams))
    items = list(recording.episodes())
    return recording, [item for item in items if not isinstance(item, Skipped)], [
        item for item in items if isinstance(item, Skipped)
    ]  # fmt: skip


def shows(episode, first=0):
    """Whether the episode's pictures are those of recordings.pictures, forwards and in any order."""
    wanted = make.pictures(episode.frames.count, first=first)
    np.testing.assert_array_equal(episode.frames.read(np.arange(episode.frames.count)), wanted)
    some = np.array([5, 2, 2, episode.frames.count - 1, 0])
    np.testing.assert_array_equal(episode.frames.read(some), wanted[some])
    episode.frames.close()
    np.testing.assert_array_equal(episode.frames.read([3]), wanted[[3]])


@pytest.mark.parametrize("version", ["v2.0", "v2.1"])
def test_lerobot_v2_gives_rows_pictures_names_and_units(tmp_path, version):
    recording, episodes, skipped = read_all(make.lerobot_v2(tmp_path / "data_set", [12, 9], version=version))
    assert recording.format == f"LeRobot {version}" and recording.rate_hz == 20 and not skipped and not recording.notes
    for number, (episode, length) in enumerate(zip(episodes, [12, 9], strict=True)):
        shows(episode, first=100 * number)
        np.testing.assert_array_equal(episode.action, make.commands(length, 2, seed=number))
        np.testing.assert_array_equal(episode.state, make.commands(length, 3, seed=100 + number))
        assert (episode.action_names, episode.action_units) == (["left_n", "right_n"], ["N", "N"])
        assert episode.state_units == ["m", "m/s", "unknown"]
        np.testing.assert_allclose(episode.times, np.arange(length) / 20, atol=1e-6)
        np.testing.assert_allclose(episode.frames.times, np.arange(length) / 20, atol=1e-9)


def test_lerobot_v2_names_what_is_not_there_and_reads_the_rest(tmp_path):
    path = make.lerobot_v2(tmp_path / "data_set", [12, 9, 8])
    next(path.glob("videos/*/*/episode_000001.mp4")).unlink()
    next(path.glob("data/*/episode_000002.parquet")).unlink()
    _, episodes, skipped = read_all(path)
    assert [episode.name for episode in episodes] == ["episode 0"]
    assert [entry.name for entry in skipped] == ["episode 1", "episodes 2"]
    assert "no video" in skipped[0].reason and "not there" in skipped[1].reason


def test_lerobot_v2_finds_files_that_the_metadata_do_not_lead_to(tmp_path):
    path = make.lerobot_v2(tmp_path / "data_set", [12, 9])
    info = json.loads((path / "meta/info.json").read_text())
    info["data_path"] = "data/chunk-{episode_index:03d}/episode_{episode_index:06d}.parquet"
    info["total_videos"] = 7
    (path / "meta/info.json").write_text(json.dumps(info))
    recording, episodes, _ = read_all(path)
    assert len(episodes) == 2
    assert any("data_path does not lead to the file of 1 of 2 episodes (1)" in note for note in recording.notes)
    assert any("total_videos is 7; 2 are there" in note for note in recording.notes)


def test_lerobot_v3_takes_each_episode_out_of_the_shared_files(tmp_path):
    recording, episodes, skipped = read_all(make.lerobot_v3(tmp_path / "data_set", [12, 9, 10]))
    assert recording.format == "LeRobot v3.0" and not skipped and not recording.notes
    for number, (episode, length) in enumerate(zip(episodes, [12, 9, 10], strict=True)):
        shows(episode, first=100 * number)
        np.testing.assert_array_equal(episode.action, make.commands(length, 2, seed=number))
        assert episode.frames.times[0] == 0


def test_lerobot_v3_counts_pictures_where_the_stamps_of_the_metadata_drift(tmp_path):
    path = make.lerobot_v3(tmp_path / "data_set", [12, 9, 10])
    pq = pytest.importorskip("pyarrow.parquet")
    file = path / "meta/episodes/chunk-000/file-000.parquet"
    columns = pq.read_table(file).to_pydict()
    key = "videos/observation.images.front/from_timestamp"
    columns[key] = [stamp + 0.06 * episode for episode, stamp in enumerate(columns[key])]
    make.write_parquet(file, {name: np.array(column) for name, column in columns.items()})
    recording, episodes, _ = read_all(path)
    shows(episodes[2], first=200)
    assert any("drift" in note for note in recording.notes)


def test_lerobot_v3_reads_the_rows_from_the_file_that_holds_them(tmp_path):
    """A stale file index in the metadata, as one writer leaves it when a file is full."""
    path = make.lerobot_v3(tmp_path / "data_set", [12, 9])
    pq = pytest.importorskip("pyarrow.parquet")
    table = pq.read_table(path / "data/chunk-000/file-000.parquet")
    pq.write_table(table.slice(0, 12), path / "data/chunk-000/file-000.parquet")
    pq.write_table(table.slice(12), path / "data/chunk-000/file-001.parquet")
    _, episodes, skipped = read_all(path)
    assert not skipped
    np.testing.assert_array_equal(episodes[1].action, make.commands(9, 2, seed=1))
    assert "file-001.parquet" in episodes[1].notes[0]


def test_a_camera_that_is_not_there_is_answered_with_those_that_are(tmp_path):
    with pytest.raises(ValueError, match=r"no camera wrist; the files have observation\.images\.front"):
        open_recording(make.lerobot_v2(tmp_path / "data_set", [12]), Streams(camera="wrist"))


def test_a_lerobot_data_set_of_pointers_is_refused_in_one_sentence(tmp_path):
    path = make.lerobot_v2(tmp_path / "data_set", [12])
    for file in path.rglob("*.parquet"):
        file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n")
    with pytest.raises(ValueError, match=r"Git LFS pointer.*git lfs pull"):
        open_recording(path)


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


def test_robomimic(tmp_path):
    recording, episodes, _ = read_all(make.robomimic(tmp_path / "demo.hdf5", [12] * 11))
    assert "robomimic" in recording.format
    assert [episode.name for episode in episodes][1:3] == ["demo_1", "demo_2"]
    shows(episodes[10], first=1000)
    np.testing.assert_array_equal(episodes[10].action, make.commands(12, 2, seed=10))
    assert episodes[0].state.shape == (12, 5)


@pytest.mark.parametrize("coded", [False, True])
def test_aloha(tmp_path, coded):
    recording, episodes, _ = read_all(make.aloha(tmp_path / "aloha", [12, 9], coded))
    assert "ALOHA" in recording.format and recording.cameras == ["observations/images/cam_high"]
    shows(episodes[1], first=100)
    np.testing.assert_array_equal(episodes[1].action, make.commands(9, 14, seed=1))
    np.testing.assert_array_equal(episodes[1].state, make.commands(9, 14, seed=51))


def test_stable_worldmodel(tmp_path):
    recording, episodes, _ = read_all(make.stable_worldmodel(tmp_path / "world.h5", [12, 9]))
    assert "stable-worldmodel" in recording.format
    shows(episodes[1], first=100)
    np.testing.assert_array_equal(episodes[1].action[:-1], make.commands(9, 2, seed=1)[:-1])


def test_hdf5_of_another_layout_by_naming_the_keys(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "own.h5", "w") as file:
        file["log/view"], file["log/motor"], file["log/clock"] = make.pictures(8), make.commands(8), np.arange(8) / 20
    _, _, (entry,) = read_all(tmp_path / "own.h5")
    assert "log/motor (8, 2)" in entry.reason and "--action" in entry.reason
    _, (episode,), _ = read_all(tmp_path / "own.h5", action=["log/motor"], time="log/clock")
    shows(episode)
    np.testing.assert_allclose(episode.times, np.arange(8) / 20)


def test_hdf5_that_claims_more_than_it_holds_is_refused_without_reading_it(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "huge.h5", "w") as file:
        file.create_dataset("pixels", shape=(10**9, 480, 640, 3), dtype="u1", chunks=(1, 480, 640, 3))
        file.create_dataset("action", shape=(10**9, 2), dtype="f4", chunks=(1024, 2))
    _, _, (entry,) = read_all(tmp_path / "huge.h5")
    assert "claims the shape (1000000000, " in entry.reason


def test_npz_with_one_picture_more_than_commands(tmp_path):
    _, (episode,), _ = read_all(make.npz(tmp_path / "episode.npz", 10))
    assert episode.frames.count == 11 and episode.action.shape == (10, 2)
    shows(episode)


def test_nothing_pickled_is_read(tmp_path):
    np.savez(tmp_path / "a.npz", pixels=make.pictures(8), action=np.array([{"a": 1}] * 8, dtype=object))
    _, _, (entry,) = read_all(tmp_path / "a.npz")
    assert "no commands" in entry.reason


def test_npz_that_claims_more_than_it_holds_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", action=make.commands(8))
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive:
        header = b"{'descr': '|u1', 'fortran_order': False, 'shape': (1000000000000, 64, 64, 3), }".ljust(117) + b"\n"
        member = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
        archive.writestr("pixels.npy", member)
    _, _, (entry,) = read_all(tmp_path / "a.npz")
    assert "pixels.npy in a.npz claims (1000000000000, 64, 64, 3)" in entry.reason


@pytest.mark.parametrize("mcap", [False, True])
def test_ros_2_bags(tmp_path, mcap):
    times = np.arange(12) / 20
    recording, (episode,), _ = read_all(make.rosbag(tmp_path / "bag", times, mcap))
    assert recording.format == f"ROS 2 bag ({'mcap' if mcap else 'db3'})"
    shows(episode)
    np.testing.assert_array_equal(episode.action[:, 0], make.commands(12, 1)[:, 0])
    assert episode.action_names[0] == "cmd_vel/linear.x" and episode.action.shape == (12, 6)
    np.testing.assert_allclose(episode.frames.times - episode.times, 0.01, atol=1e-6)
    _, (episode,), _ = read_all(tmp_path / "bag", action=["/cmd_vel/linear/x"], camera="/camera/image_raw")
    assert episode.action_names == ["cmd_vel/linear.x"]


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


def test_pictures_in_the_order_of_the_rows_that_name_them(tmp_path):
    for number, frame in enumerate(make.pictures(8)):
        cv2.imwrite(str(tmp_path / f"{chr(104 - number)}.png"), frame[..., ::-1])
    names = [f"images/{chr(104 - number)}.png" for number in range(8)]
    dates = [f"2026-01-02 03:04:05.{125 * k:03d}" for k in range(8)]
    make.write_csv(tmp_path / "rows.csv", {"time": dates, "image": names, "action": range(8)})
    _, (episode,), _ = read_all(tmp_path)
    shows(episode)
    np.testing.assert_allclose(episode.times - episode.times[0], np.arange(8) / 8, atol=1e-6)


def test_lerobot_with_pictures_in_its_rows(tmp_path):
    path = make.lerobot_v2(tmp_path / "data_set", [12, 9])
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    for episode, file in enumerate(sorted(path.glob("data/*/*.parquet"))):
        table = pq.read_table(file)
        frames = make.pictures(len(table), first=100 * episode)
        cells = [{"bytes": cv2.imencode(".png", frame[..., ::-1])[1].tobytes(), "path": None} for frame in frames]
        pq.write_table(table.append_column("observation.images.front", pa.array(cells)), file, row_group_size=5)
    shutil.rmtree(path / "videos")
    _, episodes, skipped = read_all(path)
    assert not skipped
    shows(episodes[1], first=100)


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
def test_a_bag_without_its_metadata(tmp_path, suffix):
    bag = make.rosbag(tmp_path / "bag", np.arange(12) / 20, suffix == "mcap")
    (bag / "metadata.yaml").unlink()
    _, (episode,), _ = read_all(next(bag.glob(f"*.{suffix}")))
    shows(episode)


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
def test_a_folder_of_a_bag_without_its_metadata(tmp_path, suffix):
    bag = make.rosbag(tmp_path / "bag", np.arange(12) / 20, suffix == "mcap")
    (bag / "metadata.yaml").unlink()
    _, (episode,), _ = read_all(bag)
    shows(episode)


def test_a_bounded_file_takes_no_memory_for_bytes_that_it_does_not_have(tmp_path):
    (tmp_path / "a.bin").write_bytes(bytes(range(100)))
    with BoundedPath(tmp_path / "a.bin").open("rb") as file:
        assert file.read(10) == bytes(range(10)) and file.read(1 << 62) == bytes(range(10, 100))


def test_an_mcap_record_that_claims_more_than_the_file_is_refused(tmp_path):
    """The length of its first record is 2^62; the same file without the claim is read."""
    bag = make.rosbag(tmp_path / "bag", np.arange(12) / 20, mcap=True)
    (bag / "metadata.yaml").unlink()
    (file,) = bag.glob("*.mcap")
    data = bytearray(file.read_bytes())
    data[9:17] = (1 << 62).to_bytes(8, "little")
    file.write_bytes(data)
    with pytest.raises(ValueError, match="Truncated record at offset 17"):
        open_recording(file)


def test_hundreds_of_episodes_are_not_opened_before_they_are_asked_for(tmp_path, monkeypatch):
    from tsjepa.data.readers import lerobot_v3

    asked = []
    index = lerobot_v3.video_index
    monkeypatch.setattr(lerobot_v3, "video_index", lambda path: asked.append(path) or index(path))
    recording = open_recording(make.lerobot_v3(tmp_path / "data_set", [12, 9]))
    assert not asked
    next(recording.episodes())
    assert len(asked) == 1


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
