"""Export to LeRobot v3.0 and import again: the same bits, and the layout that LeRobot's own writer leaves."""

import json
import re

import numpy as np
import pytest
import recordings as make

from tsjepa.data.exporter import export_data
from tsjepa.data.importer import import_recording
from tsjepa.data.storage import open_split, read_metadata

parquet = pytest.importorskip("pyarrow.parquet")


@pytest.fixture
def data_set(tmp_path):
    path = make.lerobot_v2(tmp_path / "recording", [9, 9, 13])
    import_recording(str(path), str(tmp_path / "set"), size=None, slots=4)
    return tmp_path / "set"


def trajectories(folder):
    """Every trajectory of a data set as bytes of pictures, commands and states."""
    return {
        (split["pixels"][number].numpy().tobytes(), split["action"][number].numpy().tobytes(),
         split["state"][number].numpy().tobytes())
        for name in read_metadata(folder)["splits"]
        for split in [open_split(folder, name)]
        for number in range(len(split))
    }  # fmt: skip


def test_a_round_trip_keeps_every_bit(data_set, tmp_path):
    export_data(str(data_set), str(tmp_path / "lerobot"))
    import_recording(str(tmp_path / "lerobot"), str(tmp_path / "again"), size=None, slots=4)
    assert trajectories(tmp_path / "again") == trajectories(data_set)
    first, again = (read_metadata(folder)["spec"] for folder in (data_set, tmp_path / "again"))
    assert again == first


def test_the_small_codec_stays_near(data_set, tmp_path):
    export_data(str(data_set), str(tmp_path / "lerobot"), codec="small")
    import_recording(str(tmp_path / "lerobot"), str(tmp_path / "again"), size=None, slots=4, validation=0, test=0)
    again = open_split(tmp_path / "again", "train")
    sums = {split["action"][number].numpy().tobytes(): split["pixels"][number].numpy().astype(int)
            for name in read_metadata(data_set)["splits"] for split in [open_split(data_set, name)]
            for number in range(len(split))}  # fmt: skip
    for number in range(len(again)):
        original = sums[again["action"][number].numpy().tobytes()]
        assert np.abs(again["pixels"][number].numpy() - original).mean() < 4


def test_the_layout_is_that_of_lerobots_own_writer(data_set, tmp_path):
    """Paths, columns, types and keys against a data set that LeRobot 0.6.1 wrote."""
    theirs = make.wild("recordings/cartpole-lerobot-v30")
    ours = export_data(str(data_set), str(tmp_path / "lerobot"))
    info = [json.loads((folder / "meta/info.json").read_text()) for folder in (theirs, ours)]
    assert set(info[0]) == set(info[1])
    for key in ("codebase_version", "data_path", "video_path", "chunks_size"):
        assert info[0][key] == info[1][key]
    for name in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
        assert info[0]["features"][name] == info[1]["features"][name]
    theirs_camera, ours_camera = (parts["features"][key] for parts, key in zip(
        info, ("observation.images.front", "observation.images.view"), strict=True))  # fmt: skip
    assert set(theirs_camera) == set(ours_camera) and theirs_camera["names"] == ours_camera["names"]
    tables = [parquet.read_table(folder / "data/chunk-000/file-000.parquet") for folder in (theirs, ours)]
    assert set(tables[0].column_names) == set(tables[1].column_names)
    for name in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
        assert tables[0].schema.field(name).type == tables[1].schema.field(name).type
    assert str(tables[1].schema.field("action").type) == "fixed_size_list<element: float>[2]"
    entries = [parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet") for folder in (theirs, ours)]
    names = [{name.replace("images.front", "images.view") for name in table.column_names} for table in entries]
    assert names[0] == names[1]
    tasks = [parquet.read_schema(folder / "meta/tasks.parquet") for folder in (theirs, ours)]
    assert tasks[0].names == tasks[1].names
    assert [json.loads(schema.metadata[b"pandas"])["index_columns"] for schema in tasks] == [["task"]] * 2
    stats = [json.loads((folder / "meta/stats.json").read_text()) for folder in (theirs, ours)]
    assert set(stats[0]["action"]) == set(stats[1]["action"])
    assert np.shape(stats[0]["observation.images.front"]["mean"]) == np.shape(
        stats[1]["observation.images.view"]["mean"]
    )


def test_splits_are_spans_of_episodes_and_rows_count_on(data_set, tmp_path, capsys):
    capsys.readouterr()
    ours = export_data(str(data_set), str(tmp_path / "lerobot"))
    assert re.fullmatch(
        rf"{re.escape(str(ours))}: 7 episodes of LeRobot v3.0, slots of 0.05 s, 35 pictures, episodes of the splits: "
        r"train 0:\d, .*\d:7\.\n",
        capsys.readouterr().out,
    )
    info = json.loads((ours / "meta/info.json").read_text())
    counts = {name: entry["episodes"] for name, entry in read_metadata(data_set)["splits"].items()}
    assert {name: int(span.split(":")[1]) - int(span.split(":")[0]) for name, span in info["splits"].items()} == counts
    tables = [parquet.read_table(file) for file in sorted(ours.glob("data/*/*.parquet"))]
    index = np.concatenate([table["index"].to_numpy() for table in tables])
    np.testing.assert_array_equal(index, np.arange(info["total_frames"]))


def test_what_is_there_is_kept_and_a_wrong_codec_is_refused(data_set, tmp_path):
    (tmp_path / "lerobot").mkdir()
    with pytest.raises(FileExistsError, match="--overwrite true"):
        export_data(str(data_set), str(tmp_path / "lerobot"))
    with pytest.raises(ValueError, match="lossless, small"):
        export_data(str(data_set), str(tmp_path / "other"), codec="av1")
    assert not (tmp_path / "other").exists()
