"""The same recording, written as strangers write theirs: every way gives the same commands."""

import codecs
import gzip
import json

import cv2
import numpy as np
import pytest
import recordings as make

from tsjepa.data.import_plan import plan_import
from tsjepa.data.importer import import_recording
from tsjepa.data.readers import Episode, Streams, open_recording
from tsjepa.support.stamps import as_seconds, slow_note, wanted_times
from tsjepa.support.tables import read_table

ROWS, RATE = 12, 20
FORCE = make.commands(ROWS, 1)[:, 0].astype(float)
SINCE_1970 = 1_700_000_000 * 10**9


def text(mark: str = ",", end: str = "\n", names=("time_s", "action"), unit: int = 0, start: int = 0, point=".") -> str:
    """Rows at 20 Hz; ``unit`` in nanoseconds gives whole stamps, 0 seconds."""
    stamps = [(start + k * 50_000_000) // unit if unit else k / RATE for k in range(ROWS)]
    rows = [names, *zip(stamps, FORCE.tolist(), strict=True)]
    return "".join(mark.join(str(cell).replace(".", point if row else ".") for cell in cells) + end
                   for row, cells in enumerate(rows))  # fmt: skip


NS = {"unit": 1, "start": SINCE_1970}
TEXTS = {
    "semicolons.csv": text(";"),
    "tabs.tsv": text("\t"),
    "decimal-commas.csv": text(";", point=","),
    "windows.csv": text(end="\r\n"),
    "mark.csv": codecs.BOM_UTF8 + text().encode(),
    "utf16.csv": text().encode("utf-16"),
    "packed.csv.gz": gzip.compress(text().encode()),
    "commented.csv": "# of 3 May\n\n" + text(),
    "header-behind-a-comment.csv": "# " + text(),
    "index.csv": "\n".join(
        ("" if not row else str(row - 1)) + "," + line for row, line in enumerate(text().splitlines())
    ),
    "marks-at-the-end.csv": text(end=",\n"),
    "nanoseconds.csv": text(names=("timestamp_ns", "action"), **NS),
    "nanoseconds-in-no-name.csv": text(names=("timestamp", "cmd"), **NS),
    "microseconds.csv": text(names=("time_us", "u"), unit=1000, start=SINCE_1970),
    "nanoseconds-of-uptime.csv": text(names=("t_ns", "action"), unit=1, start=200_000 * 10**9),
    "milliseconds-in-seconds.csv": text(names=("time_s", "action"), unit=10**6, start=SINCE_1970),
    "milliseconds-from-zero.csv": text(names=("t_ms", "action"), unit=10**6),
    "elapsed.csv": text(names=("elapsed_time", "command")),
    "dates.csv": "time,action\n"
    + "".join(f"2024-01-01T00:00:00.{50 * k:03d}Z,{force}\n" for k, force in enumerate(FORCE)),
    "dates-in-a-zone.csv": "time,action\n"
    + "".join(f"2024-01-01 00:00:00.{50 * k:03d}+02:00,{force}\n" for k, force in enumerate(FORCE)),
    "lines.ndjson": "".join(json.dumps({"t": k / RATE, "action": [force]}) + "\n" for k, force in enumerate(FORCE)),
    "nested.jsonl": "".join(
        json.dumps({"t": k / RATE, "action": {"force": force}}) + "\r\n" for k, force in enumerate(FORCE)
    ),
    "list.json": json.dumps([{"t": k / RATE, "action": force} for k, force in enumerate(FORCE)], indent=1),
    "lists.json": json.dumps({"t": [k / RATE for k in range(ROWS)], "action": FORCE.tolist()}),
    "wrapped.json": json.dumps({"rows": [{"t": k / RATE, "action": force} for k, force in enumerate(FORCE)]}),
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_table_is_read_however_it_is_written(name, tmp_path):
    make.write_video(tmp_path / "run_0.mp4", make.pictures(ROWS), RATE)
    content = TEXTS[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    (episode,) = open_recording(tmp_path).episodes()
    assert isinstance(episode, Episode), episode
    np.testing.assert_allclose(episode.action[:, 0], FORCE, rtol=1e-6)
    np.testing.assert_allclose(episode.times - episode.times[0], np.arange(ROWS) / RATE, atol=1e-6)


def test_dates_in_zones_are_one_clock():
    words = np.array(["2024-01-01T12:00:00+02:00", "2024-01-01T10:00:01Z", "2024/01/01 10:00:02"], dtype=object)
    np.testing.assert_allclose(np.diff(as_seconds(words, 1.0)), [1, 1])
    with pytest.raises(ValueError, match="words instead of numbers or dates"):
        as_seconds(np.array(["yesterday"], dtype=object), 1.0)


@pytest.mark.parametrize(
    ("stamp", "named", "second"),
    [
        (2e14, 1e-9, 2e5),  # of a machine that has been up for 56 hours
        (2e11, 1e-6, 2e5),
        (1.7e12, 1e-3, 1.7e9),
        (1.7e18, 1.0, 1.7e9),  # no unit is named, or one that puts them beyond the year 5000
        (1.7e15, 1e-3, 1.7e9),
        (1.7e12, 1.0, 1.7e9),
        (1.7e9, 1.0, 1.7e9),
    ],
)
def test_the_size_of_a_stamp_tells_its_unit_only_where_the_name_cannot_be_right(stamp, named, second):
    np.testing.assert_allclose(as_seconds(np.array([stamp]), named), [second])


def test_dates_are_read_whatever_unit_their_column_names():
    words = np.array(["1970-01-02T00:00:00", "1970-01-02T00:00:01"], dtype=object)
    np.testing.assert_allclose(as_seconds(words, 1e-3), [86400, 86401])


def test_times_in_arrays_have_the_unit_of_their_key(tmp_path):
    np.savez(
        tmp_path / "a.npz", pixels=make.pictures(ROWS), action=FORCE, t_ns=2 * 10**14 + np.arange(ROWS) * 5 * 10**7
    )
    (episode,) = open_recording(tmp_path / "a.npz", Streams(time="t_ns")).episodes()
    np.testing.assert_allclose(episode.times - episode.times[0], np.arange(ROWS) / RATE, atol=1e-6)


@pytest.mark.parametrize(
    ("start", "line"), [("t,u\n", 3), ("# of 3 May\n\n# by hand\nt,u\n\n", 7), ("# t,u\n", 3), ('t,"u\nv"\n', 4)]
)
def test_the_line_of_a_short_row_is_that_of_the_file(tmp_path, start, line):
    (tmp_path / "rows.csv").write_text(start + "0,1\n1\n2,3\n")
    with pytest.raises(ValueError, match=f"names 2 columns and line {line} has 1 cells"):
        read_table(tmp_path / "rows.csv")


def test_a_damaged_archive_is_one_sentence(tmp_path):
    (tmp_path / "rows.csv.gz").write_bytes(gzip.compress(text().encode())[:-9])
    with pytest.raises(ValueError, match=r"rows\.csv\.gz cannot be unpacked"):
        read_table(tmp_path / "rows.csv.gz")


def test_folders_beside_one_table_are_cameras_where_each_has_a_picture_for_every_row(tmp_path):
    for camera, first in (("left", 0), ("right", 100)):
        (tmp_path / camera).mkdir()
        for number, frame in enumerate(make.pictures(ROWS, first=first)):
            cv2.imwrite(str(tmp_path / camera / f"{number}.png"), frame[..., ::-1])
    (tmp_path / "commands.csv").write_text(text())
    for camera, first in ((None, 0), ("right", 100)):
        recording = open_recording(tmp_path, Streams(camera))
        (episode,) = recording.episodes()
        assert recording.cameras == ["left", "right"]
        np.testing.assert_array_equal(episode.frames.read([3])[0], make.pictures(ROWS, first=first)[3])
    with pytest.raises(ValueError, match="There is no camera top; there are left, right"):
        open_recording(tmp_path, Streams("top"))
    (tmp_path / "left" / "11.png").unlink(), (tmp_path / "left" / "10.png").unlink()
    reasons = [skipped.reason for skipped in open_recording(tmp_path).episodes()]
    assert "is one table for 2 episodes" in reasons[0]


def test_a_table_above_nested_folders_of_pictures_is_theirs(tmp_path):
    folder = tmp_path / "run" / "rgb" / "cam"
    folder.mkdir(parents=True)
    for number, frame in enumerate(make.pictures(ROWS)):
        cv2.imwrite(str(folder / f"{number:03d}.png"), frame)
    (tmp_path / "rows.csv").write_text(text())
    (episode,) = open_recording(tmp_path).episodes()
    assert episode.frames.count == ROWS


def group_an_episode(path, prefix: str):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for episode in (0, 2, 10):
            file[f"{prefix}_{episode}/action"] = make.commands(ROWS, 2, seed=episode)
            file[f"{prefix}_{episode}/obs/rgb"] = make.pictures(ROWS, first=episode)
    return path


def test_groups_at_the_top_of_an_hdf5_file_are_episodes(tmp_path):
    recording = open_recording(group_an_episode(tmp_path / "demo.h5", "traj"))
    episodes = list(recording.episodes())
    assert recording.format == "HDF5, a group an episode"
    assert [episode.name for episode in episodes] == ["traj_0", "traj_2", "traj_10"]
    np.testing.assert_array_equal(episodes[2].action, make.commands(ROWS, 2, seed=10))


def varied(kind: str) -> np.ndarray:
    """The pictures of :func:`recordings.pictures` as others store them."""
    frames = make.pictures(ROWS)
    return {
        "channels first": frames.transpose(0, 3, 1, 2),
        "with alpha": np.concatenate([frames, frames[..., :1]], axis=-1),
        "0 to 1": (frames / 255).astype(np.float32),
        "-1 to 1, channels first": (frames / 127.5 - 1).astype(np.float32).transpose(0, 3, 1, 2),
        "0 to 255": frames.astype(np.float32),
        "16 bits": frames.astype(np.uint16) * 257,
    }[kind]


KINDS = ["channels first", "with alpha", "0 to 1", "-1 to 1, channels first", "0 to 255", "16 bits"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", ["npz", "h5"])
def test_pictures_in_arrays_are_the_same_however_they_are_scaled(kind, suffix, tmp_path):
    arrays = {"pixels": varied(kind), "action": make.commands(ROWS, 2), "time": np.arange(ROWS)[:, None] / RATE}
    if suffix == "npz":
        np.savez(tmp_path / "run.npz", **arrays)
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(tmp_path / "run.h5", "w") as file:
            for name, array in arrays.items():
                file.create_dataset(name, data=array, compression="gzip")
    (episode,) = open_recording(tmp_path).episodes()
    np.testing.assert_allclose(episode.times, np.arange(ROWS) / RATE)
    np.testing.assert_array_equal(episode.frames.read(np.arange(ROWS)), make.pictures(ROWS))


def test_dark_pictures_of_a_recording_in_0_to_255_stay_dark(tmp_path):
    frames = make.pictures(ROWS).astype(np.float32)
    frames[4] = 1.0
    np.savez(tmp_path / "run.npz", pixels=frames, action=make.commands(ROWS, 2))
    (episode,) = open_recording(tmp_path, Streams(rate_hz=RATE)).episodes()
    assert (episode.frames.read([4]) == 1).all()


def test_grey_arrays_are_pictures_by_their_name(tmp_path):
    grey = make.pictures(ROWS)[..., 0]
    np.savez(tmp_path / "run.npz", images=grey, action=make.commands(ROWS, 2))
    import_recording(str(tmp_path), str(tmp_path / "set"), size=None, slots=4, rate_hz=RATE)
    (episode,) = open_recording(tmp_path, Streams(rate_hz=RATE)).episodes()
    np.testing.assert_array_equal(episode.frames.read([5])[0], np.repeat(grey[5][..., None], 3, axis=-1))


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["950,0", '"1,234",1', '"1,310,000.5",2'], [950, 1234, 1310000.5]),  # thousands
        (['"0,125",0', '"1,234",1', '"2,5",2'], [0.125, 1.234, 2.5]),  # which these cannot all be
        (["950;0", "1,234;1", "1,310;2"], [950, 1.234, 1.31]),
    ],
)
def test_a_comma_in_a_number_is_read_by_what_separates_the_cells(tmp_path, lines, expected):
    mark = ";" if ";" in lines[0] else ","
    (tmp_path / "a.csv").write_text("\n".join([f"force{mark}time", *lines]) + "\n")
    np.testing.assert_allclose(read_table(tmp_path / "a.csv")["force"], expected)


def test_an_open_quote_is_named_with_its_line(tmp_path):
    (tmp_path / "a.csv").write_text('a,b\n1,2\n"3,4\n' + "5,6\n" * 50_000)
    with pytest.raises(ValueError, match=r"a\.csv: the row that begins in line 3 cannot be read .* is a quote open"):
        read_table(tmp_path / "a.csv")


@pytest.mark.parametrize(("unit", "count"), [("ms", 50), ("us", 50_000), ("ns", 50_000_000)])
def test_times_without_a_unit_that_rise_fast_are_asked_about_and_one_may_be_given(tmp_path, unit, count):
    (tmp_path / "run").mkdir()
    for number, picture in enumerate(make.pictures(ROWS)):
        cv2.imwrite(str(tmp_path / "run" / f"{number}.png"), picture)
    rows = [f"{count * k},{force}" for k, force in enumerate(FORCE)]
    (tmp_path / "run.csv").write_text("\n".join(["time,action", *rows]))
    plan = plan_import(open_recording(tmp_path))
    assert plan.slot == pytest.approx(count)
    (note,) = [note for note in plan.notes if "states no unit" in note]
    assert f"run: its column time states no unit and is taken for seconds, a row every {count:.4g} s" in note
    assert f"call it time_{unit}, or pass --time 'time({unit})'" in note
    plan = plan_import(open_recording(tmp_path, Streams(time=f"time({unit})")))
    assert plan.slot == pytest.approx(0.05) and not any("unit" in note for note in plan.notes)


@pytest.mark.parametrize("name", ["time_s", "time", "stamp(s)"])
def test_a_slow_recording_that_says_so_is_not_asked_about(name):
    slow, quick = np.array([0.0, 60.0, 120.0, 120.0, 180.0]), np.arange(5) * 0.05
    assert slow_note(name, quick) == []
    assert len(slow_note(name, slow)) == (name == "time")
    assert slow_note("time", 1_700_000_000_000 + 50 * np.arange(5)) == []  # since 1970: their size tells the unit
    assert slow_note("time", np.array(["2024-01-01", "2024-01-02"], dtype=object)) == []


def test_the_wanted_times_may_have_their_unit_behind_their_name():
    names = ["clock", "clock_ms", "t(us)"]
    assert wanted_times("clock", names) == ("clock", None)
    assert wanted_times("clock_ms", names) == ("clock_ms", 1e-3)
    assert wanted_times("clock(ms)", names) == ("clock", 1e-3)
    assert wanted_times("t(us)", names) == ("t(us)", 1e-6)
    for absent in ("watch", "clock(lightyears)", "watch(ms)"):
        with pytest.raises(ValueError, match=r"there is no column .*; there are clock, clock_ms, t\(us\)"):
            wanted_times(absent, names)
