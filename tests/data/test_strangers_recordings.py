"""Tubs, arrays and folders of pictures as strangers leave them: every way gives the same pictures and commands."""

import json

import cv2
import numpy as np
import pytest
import recordings as make

from tsjepa.data.importer import import_recording
from tsjepa.data.readers import Skipped, Streams, open_recording
from tsjepa.data.storage import open_split

LENGTHS = [12, 9]
ACTION = np.concatenate([make.commands(length, 2, seed) for seed, length in enumerate(LENGTHS)])
PIXELS = np.concatenate([make.pictures(length, first=100 * seed) for seed, length in enumerate(LENGTHS)])


def read(path, **streams):
    items = list(open_recording(path, Streams(**streams)).episodes())
    return [item for item in items if not isinstance(item, Skipped)], [
        item for item in items if isinstance(item, Skipped)
    ]


def coded(frame):
    return cv2.imencode(".png", frame[..., ::-1])[1].tobytes()


def tub_v1(path, count, meta=True, timed=True):
    path.mkdir()
    for index, frame in enumerate(make.pictures(count)):
        (path / f"{index}_cam-image_array_.png").write_bytes(coded(frame))
        angle, throttle = make.commands(count, 2)[index].tolist()
        record = {"cam/image_array": f"{index}_cam-image_array_.png", "user/angle": angle, "user/throttle": throttle,
                  "user/mode": "user", "imu/acl_x": float(index)}  # fmt: skip
        record |= {"milliseconds": 50 * index} if timed else {}
        (path / f"record_{index}.json").write_text(json.dumps(record))
    kinds = {"cam/image_array": "image_array", "user/angle": "float", "user/throttle": "float", "user/mode": "str",
             "imu/acl_x": "float"}  # fmt: skip
    if meta:
        (path / "meta.json").write_text(json.dumps({"inputs": list(kinds), "types": list(kinds.values())}))
    return path


@pytest.mark.parametrize("meta", [True, False])
def test_a_tub_of_version_1(tmp_path, meta):
    path = tub_v1(tmp_path / "tub", 12, meta)
    (path / "record_11.json").write_text("{")
    recording = open_recording(path, Streams(state="imu/acl_x"))
    (episode,) = recording.episodes()
    assert recording.format == "Donkeycar tub v1" and "1 records are no JSON (record_11.json)" in recording.notes[0]
    np.testing.assert_array_equal(episode.frames.read(np.arange(11)), make.pictures(11))
    np.testing.assert_array_equal(episode.action, make.commands(12, 2)[:11])
    np.testing.assert_array_equal(episode.state[:, 0], np.arange(11))
    np.testing.assert_allclose(episode.times, np.arange(11) / 20)


def test_a_tub_without_times_asks_for_its_rate_and_an_unknown_column_is_named(tmp_path):
    path = tub_v1(tmp_path / "tub", 12, timed=False)
    with pytest.raises(ValueError, match="--rate_hz"):
        import_recording(str(path), str(tmp_path / "set"), slots=4)
    import_recording(str(path), str(tmp_path / "set"), slots=4, rate_hz=20)
    with pytest.raises(ValueError, match="records no imu/gyr_z; it records cam/image_array"):
        open_recording(path, Streams(state="imu/gyr_z"))


def holds_all(path):
    episodes, skipped = read(path, rate_hz=20)
    assert not skipped and [len(episode.action) for episode in episodes] == LENGTHS
    for number, episode in enumerate(episodes):
        np.testing.assert_array_equal(episode.action, make.commands(LENGTHS[number], 2, number))
        np.testing.assert_array_equal(
            episode.frames.read(np.arange(LENGTHS[number])), make.pictures(LENGTHS[number], first=100 * number)
        )


BOUNDS = {
    "meta/episode_ends": np.cumsum(LENGTHS),
    "ep_idx": np.repeat([3, 4], LENGTHS),
    "episode_index": np.repeat([0, 1], LENGTHS)[:, None],
    "terminals": np.arange(21) == 11,
    "ep_len": np.array(LENGTHS),
}


@pytest.mark.parametrize(("prefix", "key"), [*(("", key) for key in BOUNDS), ("data/", "meta/episode_ends")])
def test_episodes_in_flat_arrays_are_told_apart_however_the_file_says_it(tmp_path, key, prefix):
    h5py = pytest.importorskip("h5py")
    arrays = {prefix + "img": PIXELS, prefix + "action": ACTION, key: BOUNDS[key]}
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name, array in arrays.items():
            file[name] = array
    holds_all(tmp_path)


def test_episodes_of_a_replay_buffer_as_npz(tmp_path):
    np.savez(tmp_path / "run.npz", img=PIXELS, action=ACTION, episode_ends=np.cumsum(LENGTHS))
    holds_all(tmp_path)
    np.savez(tmp_path / "run.npz", img=PIXELS, action=ACTION, episode_ends=np.array([12, 9]))
    _, (entry,) = read(tmp_path, rate_hz=20)
    assert "do not rise to its 21 rows" in entry.reason


@pytest.mark.parametrize("kind", ["fixed", "varying"])
def test_coded_pictures_in_hdf5_as_strings_or_rows(tmp_path, kind):
    h5py = pytest.importorskip("h5py")
    cells = [coded(frame) for frame in make.pictures(9)]
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["action"] = make.commands(9, 2)
        if kind == "fixed":
            file["observations/images/cam"] = np.array(cells)
        else:
            data = file.create_dataset("observations/images/cam", (9,), dtype=h5py.vlen_dtype(np.uint8))
            for place, cell in enumerate(cells):
                data[place] = np.frombuffer(cell, np.uint8)
    (episode,), _ = read(tmp_path, rate_hz=20)
    np.testing.assert_array_equal(episode.frames.read(np.arange(9)), make.pictures(9))


def pictures(folder, count, name="{}.png", first=0):
    folder.mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(make.pictures(count, first=first)):
        (folder / name.format(number)).write_bytes(coded(frame))


@pytest.mark.parametrize("column", ["filename", "file", "center", "rgb_path"])
@pytest.mark.parametrize("folder", ["", "C:\\data\\IMG\\", "IMG/"])
def test_rows_name_their_pictures_in_any_column(tmp_path, column, folder):
    pictures(tmp_path / "IMG", 9)
    order = np.arange(9)[::-1]
    names = [f"{folder}{number}.png" for number in order]
    make.write_csv(tmp_path / "log.csv", {column: names, "action": range(9), "time": np.arange(9) / 20})
    (tmp_path / "camera.json").write_text(json.dumps({"focal_px": 300, "model": "x"}))
    (episode,), skipped = read(tmp_path)
    np.testing.assert_array_equal(episode.frames.read(np.arange(9)), make.pictures(9)[order])
    np.testing.assert_array_equal(episode.action[:, 0], np.arange(9))
    assert not skipped


def test_rows_of_three_cameras(tmp_path):
    for number, side in enumerate(("center", "left")):
        pictures(tmp_path / "IMG", 9, side + "_{}.png", first=100 * number)
    columns = {side: [f"IMG/{side}_{k}.png" for k in range(9)] for side in ("center", "left")}
    make.write_csv(tmp_path / "log.csv", {**columns, "action": range(9)})
    for camera, first in ((None, 0), ("left", 100)):
        (episode,), _ = read(tmp_path, camera=camera, rate_hz=20)
        np.testing.assert_array_equal(episode.frames.read(np.arange(9)), make.pictures(9, first=first))


@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("timed", [True, False])
def test_a_lost_picture_does_not_shift_the_commands_of_the_others(tmp_path, numbered, timed):
    pictures(tmp_path / "run", 12, "frame{}.png")
    (tmp_path / "run/frame5.png").unlink()
    columns = {"action": range(12)} | ({"frame": range(12)} if numbered else {})
    columns |= {"time": np.arange(12) / 20} if timed else {}
    make.write_csv(tmp_path / "run.csv", columns)
    (episode,), _ = read(tmp_path, rate_hz=20)
    kept = np.delete(np.arange(12), 5)
    np.testing.assert_array_equal(episode.action[:, 0], kept)
    np.testing.assert_allclose(episode.times, kept / 20)
    assert "1 of 12 rows have no picture (5)" in episode.notes[0]
    import_recording(str(tmp_path), str(tmp_path / "set"), size=None, slots=10, rate_hz=20, validation=0, test=0)
    split = open_split(tmp_path / "set", "train")
    shown = split["pixels"][0, :-1, 0, 0, 0].long()
    np.testing.assert_array_equal(shown, split["action"][0, :-1, 0].long())  # picture k stands beside command k


def test_pictures_named_by_seconds_with_a_fraction(tmp_path):
    stamps = [f"17000000{k // 2:02d}.{5 * (k % 2)}" for k in range(9)]
    (tmp_path / "run").mkdir()
    for stamp, frame in zip(stamps, make.pictures(9), strict=True):
        (tmp_path / f"run/{stamp}.png").write_bytes(coded(frame))
    make.write_csv(tmp_path / "run.csv", {"time": [1.7e9 + k / 2 for k in range(9)], "action": range(9)})
    (episode,), _ = read(tmp_path)
    np.testing.assert_allclose(episode.frames.times - 1.7e9, np.arange(9) / 2, atol=1e-6)
    np.testing.assert_array_equal(episode.frames.read([8])[0], make.pictures(9)[8])


def test_a_table_without_names_is_refused(tmp_path):
    pictures(tmp_path / "run", 9)
    (tmp_path / "run.csv").write_text("".join(f"{k}.png,{k / 8}\n" for k in range(1, 9)))
    _, (entry, *_) = read(tmp_path)
    assert "holds numbers instead of names" in entry.reason
