"""Videos that share a table with a column of numbers: which rows are whose, and where nobody can tell."""

import numpy as np
import pytest
import recordings as make
from reading import read_all

from tsjepa import cli
from tsjepa.data.importer import import_recording
from tsjepa.data.inspect import inspect_recording

ROWS = 12


def folder_of(folder, stems: list[str], episodes: list[int], column: str = "episode", step_s: float = 0.05):
    """Videos of these names, and a table in which episode number n has the commands n, n + 0.01, ..."""
    for number, stem in enumerate(stems):
        make.write_video(folder / f"{stem}.mp4", make.pictures(ROWS, first=number), 20)
    rows = np.arange(ROWS)
    make.write_csv(
        folder / "commands.csv",
        {
            column: np.repeat(episodes, ROWS).tolist(),
            "time_s": np.tile(rows * step_s, len(episodes)).tolist(),
            "force_n": np.concatenate([number + 0.01 * rows for number in episodes]).tolist(),
        },
    )
    return folder


@pytest.mark.parametrize(
    "stems",
    [
        ["ep1", "ep2", "ep10"],
        ["ep1_v2", "ep2_v2", "ep10_v2"],  # the last number is one of the table's episodes
        ["cam2_ep1", "cam2_ep2", "cam2_ep10"],
        ["drive1_20240501", "drive2_20240502", "drive10_20240503"],
        ["run1_640x480", "run2_640x480", "run10_640x480"],
    ],
)
def test_the_number_that_tells_the_videos_apart_names_the_episode(tmp_path, stems):
    _, episodes, skipped = read_all(folder_of(tmp_path, stems, [1, 2, 10]), action="force_n")
    assert not skipped
    assert {episode.name: float(episode.action[0, 0]) for episode in episodes} == {
        f"{stem}.mp4": number for stem, number in zip(stems, (1, 2, 10), strict=True)
    }


@pytest.mark.parametrize(
    ("stems", "episodes", "said"),
    [
        (["ep1_2", "ep2_3"], [1, 2, 3], "several of the numbers in its name (1, 2) are episodes of the table"),
        (["run1", "run2", "run3"], [0, 1, 2], "the names count from 1 and the table from 0"),
    ],
)
def test_rows_that_may_be_anothers_are_not_taken(tmp_path, stems, episodes, said):
    _, read, skipped = read_all(folder_of(tmp_path, stems, episodes), action="force_n")
    assert not read
    assert f"{said}: write the names of the files into the table's column." in skipped[0].reason


def test_a_video_of_an_episode_that_is_not_there_is_left_out(tmp_path):
    _, episodes, skipped = read_all(folder_of(tmp_path, ["ep1", "ep2", "ep7"], [1, 2, 3]), action="force_n")
    assert [episode.name for episode in episodes] == ["ep1.mp4", "ep2.mp4"]
    assert skipped[0].name == "ep7.mp4" and "no rows" in skipped[0].reason


def test_a_camera_that_is_not_there_is_named_where_there_is_one_view(tmp_path):
    folder = folder_of(tmp_path, ["ep1", "ep2"], [1, 2])
    with pytest.raises(ValueError, match="There is no camera wrist; its episodes have one each, so leave it out"):
        inspect_recording(str(folder), camera="wrist", action="force_n")


@pytest.mark.parametrize("rate_hz", [0, -20])
def test_a_rate_that_cannot_be_is_named(tmp_path, capsys, rate_hz):
    folder = str(folder_of(tmp_path / "videos", ["ep1"], [1]))
    with pytest.raises(ValueError, match=f"rate_hz is {rate_hz}: it is pictures a second"):
        import_recording(folder, str(tmp_path / "data"), rate_hz=rate_hz)
    assert cli.main(["inspect", folder, f"--rate_hz={rate_hz}"]) == 2
    assert f"rate_hz is {rate_hz}" in capsys.readouterr().err


def test_times_that_fit_no_two_pictures_are_not_advised_to_be_imported(tmp_path):
    folder = folder_of(tmp_path, ["ep1"], [1], step_s=50.0)  # milliseconds
    with pytest.raises(
        ValueError, match=r"No two pictures of .* follow each other .* call their column time_ms.*--time"
    ):
        inspect_recording(str(folder), action="force_n")
