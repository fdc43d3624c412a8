"""LeRobot data sets against small ones whose pictures and commands are known."""

import json
import shutil

import cv2
import numpy as np
import pytest
import recordings as make
from reading import read_all, shows

from tsjepa.data.readers import open_recording


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


def test_a_lerobot_data_set_of_pointers_is_refused_in_one_sentence(tmp_path):
    path = make.lerobot_v2(tmp_path / "data_set", [12])
    for file in path.rglob("*.parquet"):
        file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n")
    with pytest.raises(ValueError, match=r"Git LFS pointer.*git lfs pull"):
        open_recording(path)


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
