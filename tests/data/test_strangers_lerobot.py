"""LeRobot data sets as strangers write them: every oddity gives the same pictures and commands."""

import json
import shutil

import cv2
import numpy as np
import pytest
import recordings as make
from reading import read_all

from tsjepa.data.importer import import_recording
from tsjepa.data.readers import Skipped, open_recording
from tsjepa.data.storage import open_split

pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
LENGTHS = [12, 9, 10]
CELL = pa.struct([("bytes", pa.binary()), ("path", pa.string())])


@pytest.fixture
def v2(tmp_path):
    return make.lerobot_v2(tmp_path / "recording", LENGTHS)


def change_rows(path, change):
    """Every Parquet file of rows through ``change(table, episode)``."""
    for episode, file in enumerate(sorted(path.glob("data/*/*.parquet"))):
        pq.write_table(change(pq.read_table(file), episode), file)


def change_info(path, **values):
    file = path / "meta/info.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **values}))


def frames_of(episode):
    return make.pictures(LENGTHS[episode], first=100 * episode)


def coded(frame):
    return cv2.imencode(".png", frame[..., ::-1])[1].tobytes()


def holds_all(recording):
    """Whether it gives the pictures and commands of all episodes; returns the episodes."""
    episodes = list(recording.episodes())
    for number, episode in enumerate(episodes):
        assert not isinstance(episode, Skipped), episode
        np.testing.assert_array_equal(episode.frames.read(np.arange(LENGTHS[number])), frames_of(number))
        np.testing.assert_array_equal(episode.action, make.commands(LENGTHS[number], 2, seed=number))
    assert len(episodes) == len(LENGTHS)
    return episodes


def with_pictures(cells):
    def change(table, episode):
        return table.append_column("image", pa.array(cells(episode), type=CELL))

    return change


@pytest.mark.parametrize("declared", [True, False])
def test_pictures_in_a_column_of_any_name_with_actions_and_state(v2, declared):
    shutil.rmtree(v2 / "videos")
    names = ["actions", "state", "timestamp", "frame_index", "episode_index", "index"]
    change_rows(v2, lambda table, _: table.rename_columns(names))
    change_rows(
        v2, with_pictures(lambda episode: [{"bytes": coded(frame), "path": "x"} for frame in frames_of(episode)])
    )
    features = {"image": {"dtype": "image", "shape": [16, 24, 3]}, "actions": {"dtype": "float32", "shape": [2]}}
    change_info(v2, features=features if declared else {})
    episodes = holds_all(open_recording(v2))
    assert episodes[0].action_names == ["actions_0", "actions_1"] and episodes[0].state.shape == (12, 3)


def test_pictures_that_the_rows_only_name(v2):
    shutil.rmtree(v2 / "videos")
    cells = {}
    for episode in range(3):
        folder = v2 / f"images/front/{episode}"
        folder.mkdir(parents=True)
        for number, frame in enumerate(frames_of(episode)):
            (folder / f"{number}.png").write_bytes(coded(frame))
        cells[episode] = [{"bytes": None, "path": f"images/front/{episode}/{k}.png"} for k in range(LENGTHS[episode])]
    change_rows(v2, with_pictures(cells.get))
    holds_all(open_recording(v2))
    (v2 / "images/front/1/0.png").unlink()
    (v2.parent / "outside.png").write_bytes(coded(frames_of(0)[0]))
    change_rows(v2, lambda table, _: table.drop(["image"]))
    cells[2][0]["path"] = "../outside.png"
    change_rows(v2, with_pictures(cells.get))
    skipped = [item.reason for item in open_recording(v2).episodes() if isinstance(item, Skipped)]
    assert [name in reason for name, reason in zip(("images/front/1/0.png", "../outside.png"), skipped, strict=True)]
    assert all("is not there" in reason for reason in skipped)


def test_pictures_in_a_folder_an_episode(v2):
    shutil.rmtree(v2 / "videos")
    for episode in range(3):
        folder = v2 / f"images/observation.images.front/episode_{episode:06d}"
        folder.mkdir(parents=True)
        for number, frame in enumerate(frames_of(episode)):
            (folder / f"frame_{number}.png").write_bytes(coded(frame))
    holds_all(open_recording(v2))
    shutil.rmtree(folder)
    (*_, entry) = open_recording(v2).episodes()
    assert entry.reason == "it has rows and no video of observation.images.front."


def test_lists_of_one_number_a_mark_of_its_coding_and_a_rate_in_words(v2):
    keys = ("timestamp", "frame_index", "episode_index", "index")

    def change(table, _):
        columns = table.to_pydict()
        return pa.table(columns | {key: [[value] for value in columns[key]] for key in keys})

    change_rows(v2, change)
    change_info(v2, fps="20")
    info = v2 / "meta/info.json"
    info.write_bytes(b"\xef\xbb\xbf" + info.read_bytes())
    recording = open_recording(v2)
    assert recording.rate_hz == 20
    for episode in holds_all(recording):
        np.testing.assert_allclose(np.diff(episode.times), 0.05, atol=1e-6)


def test_an_action_in_parts_and_names_as_places(v2):
    def change(table, _):
        action = np.array(table["action"].to_pylist(), np.float32)
        table = table.drop(["action"]).append_column("action.left", pa.array(action[:, 0]))
        return table.append_column("action.right", pa.array(action[:, 1:].tolist(), pa.list_(pa.float32())))

    change_rows(v2, change)
    features = {"observation.images.front": {"dtype": "video", "shape": [16, 24, 3]},
                "observation.state": {"shape": [3], "names": {"y": 1, "x": 0, "z": 2}}}  # fmt: skip
    change_info(v2, features=features)
    recording = open_recording(v2)
    episodes = holds_all(recording)
    assert episodes[0].action_names == ["action.left", "action.right"] or episodes[0].action_names == [
        "action.left_0",
        "action.right_0",
    ]
    assert episodes[0].state_names == ["x", "y", "z"]
    assert "Its action is in the columns action.left, action.right." in recording.notes


def test_the_camera_that_has_the_most_episodes_is_taken(v2):
    make.write_video(v2 / "videos/chunk-000/observation.images.aside/episode_000001.mp4", frames_of(1))
    recording = open_recording(v2)
    holds_all(recording)
    assert "observation.images.front is taken" in recording.notes[-1] or any(
        "front is taken" in note for note in recording.notes
    )
    _, (episode,), skipped = read_all(v2, camera="aside")
    assert episode.name == "episode 1" and len(skipped) == 2


def test_other_chunks_are_found(v2):
    for kind in ("data", "videos"):
        for file in list((v2 / kind).rglob("*000001.*")):
            moved = v2 / file.relative_to(v2).as_posix().replace("chunk-000", "chunk-007")
            moved.parent.mkdir(parents=True)
            file.rename(moved)
    holds_all(open_recording(v2))


def test_neither_stamps_nor_a_list_of_episodes(v2):
    change_rows(v2, lambda table, _: table.drop(["timestamp", "frame_index", "index"]))
    (v2 / "meta/episodes.jsonl").unlink()
    assert all(episode.times is None for episode in holds_all(open_recording(v2)))


def v3_in_two_files(path, length=True):
    """Episode 0 in one video, 1 and 2 in another; 0 and 1 in one file of rows, 2 in another."""
    make.lerobot_v3(path, LENGTHS)
    rows = pq.read_table(path / "data/chunk-000/file-000.parquet")
    for number, part in enumerate((rows.slice(0, 21), rows.slice(21))):
        pq.write_table(part, path / f"data/chunk-000/file-00{number}.parquet")
    videos = path / "videos/observation.images.front/chunk-000"
    make.write_video(videos / "file-000.mp4", frames_of(0))
    make.write_video(videos / "file-001.mp4", np.concatenate([frames_of(1), frames_of(2)]))
    file, key = path / "meta/episodes/chunk-000/file-000.parquet", "videos/observation.images.front/"
    columns = pq.read_table(file).to_pydict()
    columns |= {key + "file_index": [0, 1, 1], key + "from_timestamp": [0, 0, 0.45], "data/file_index": [0, 0, 1]}
    if not length:
        del columns["length"], columns["dataset_to_index"]
    pq.write_table(pa.table(columns), file)
    return path


@pytest.mark.parametrize("length", [True, False])
def test_v3_rows_and_videos_are_divided_differently(tmp_path, length):
    recording = open_recording(v3_in_two_files(tmp_path / "recording", length))
    holds_all(recording)
    assert not recording.notes


def test_v3_without_its_list_of_episodes_is_refused(tmp_path):
    path = make.lerobot_v3(tmp_path / "recording", LENGTHS)
    shutil.rmtree(path / "meta/episodes")
    with pytest.raises(ValueError, match=r"has no meta/episodes, and its rows are in file-000\.parquet"):
        open_recording(path)


def test_v3_with_pictures_in_its_rows(tmp_path):
    path = make.lerobot_v3(tmp_path / "recording", LENGTHS)
    shutil.rmtree(path / "videos")
    frames = np.concatenate([frames_of(episode) for episode in range(3)])
    change_rows(path, with_pictures(lambda _: [{"bytes": coded(frame), "path": "x"} for frame in frames]))
    holds_all(open_recording(path))


def test_a_video_at_twice_the_rate_of_the_rows_is_matched_by_time(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [12, 12], rate=10)
    for episode in range(2):
        video = path / f"videos/chunk-000/observation.images.front/episode_{episode:06d}.mp4"
        make.write_video(video, make.pictures(24, first=100 * episode), 20)
    import_recording(str(path), str(tmp_path / "set"), size=None, slots=20, validation=0, test=0)
    split = open_split(tmp_path / "set", "train")
    first, action = split["pixels"][:, :, 0, 0, 0].long(), split["action"]
    for trajectory in range(len(split)):
        episode, start = divmod(int(first[trajectory, 0]), 100)
        held = make.commands(12, 2, seed=episode)[(start + np.arange(20)) // 2]
        np.testing.assert_array_equal(action[trajectory, :20], held)


def test_arrays_that_no_clock_brings_together_are_refused(tmp_path):
    np.savez(tmp_path / "run.npz", pixels=make.pictures(24), action=make.commands(12))
    with pytest.raises(ValueError, match="12 rows and 24 pictures, and no times"):
        import_recording(str(tmp_path), str(tmp_path / "set"), rate_hz=20)
