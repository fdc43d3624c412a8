"""LeRobot v3.0: many episodes share one Parquet file and one MP4 a camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tsjepa.data.readers.episode import Episode, Skipped
from tsjepa.data.readers.lerobot_files import LeRobotFiles
from tsjepa.data.readers.pictures import natural
from tsjepa.data.readers.video import video_index
from tsjepa.support.foreign import optional
from tsjepa.support.tables import Table, parquet_rows, read_table


def list_episodes(recording: LeRobotFiles) -> list[tuple[str, Callable[[], Episode] | Skipped]]:
    """Episodes as meta/episodes lists them, their rows found by the rows' own episode_index."""
    entries = _entries(recording)
    tables: dict[Path, Table] = {}

    def rows_of(number: int, claimed: Path | None) -> tuple[Path, Table, np.ndarray]:
        """The file that holds the rows of an episode: the claimed one, else any other."""
        for file in [claimed, *recording.data_files]:
            if file is None or file not in recording.data_files:
                continue
            if file not in tables:
                if len(tables) > 4:
                    tables.clear()
                tables[file] = recording.read_rows(file)
            rows = np.flatnonzero(tables[file]["episode_index"] == number)
            if len(rows):
                return file, tables[file], rows
        raise ValueError("its rows are in no file.")

    return [
        (f"episode {number}", lambda number=number: _read(recording, entries, rows_of, number))
        for number in sorted(entries)
    ]


def _entries(recording: LeRobotFiles) -> dict[int, dict]:
    """Rows of meta/episodes by episode, the statistics left out.

    Raises:
        ValueError: there are none, or the rows of the data have no episode_index.
    """
    if "episode_index" not in recording.columns:
        raise ValueError("the rows have no column episode_index, so nobody can tell where an episode ends.")
    entries = {}
    for file in sorted((recording.path / "meta" / "episodes").rglob("*.parquet"), key=natural):
        if not parquet_rows(file):
            continue
        keys = [key for key in optional("pyarrow.parquet").read_schema(file).names if not key.startswith("stats/")]
        table = read_table(file, keys)
        for row in range(len(table.get("episode_index", ()))):
            entry = {key: table[key][row] for key in keys}
            entries[int(entry["episode_index"])] = entry
    if not entries:
        raise ValueError("meta/episodes lists no episode, so nobody can tell where one starts in a video.")
    for key, there in (("total_episodes", len(entries)),):
        if recording.info.get(key) not in (None, there):
            recording.notes.append(f"{key} is {recording.info[key]}; meta/episodes lists {there}.")
    return entries


def _file(recording: LeRobotFiles, entry: dict, key: str, prefix: str, **words: str) -> Path | None:
    try:
        chunk, index = int(entry[f"{prefix}/chunk_index"]), int(entry[f"{prefix}/file_index"])
        return recording.path / recording.info[key].format(chunk_index=chunk, file_index=index, **words)
    except (KeyError, IndexError, ValueError, AttributeError, TypeError):
        return None


def _video(recording: LeRobotFiles, entry: dict) -> Path | None:
    camera = recording.camera
    file = _file(recording, entry, "video_path", f"videos/{camera}", video_key=camera)
    files = [other for other in recording.video_files if camera in other.parts]
    if file in files:
        return file
    return files[0] if len(files) == 1 else None


def _start(recording: LeRobotFiles, entries: dict[int, dict], video: Path, number: int) -> int:
    """First frame of an episode in its video.

    Frames are counted, where a video holds as many as its episodes have rows: the stamps of the metadata are sums of
    floating-point durations, which drift from the video's own. Else the stamps decide.
    """
    key = f"videos/{recording.camera}/from_timestamp"
    numbers = [other for other in entries if _video(recording, entries[other]) == video]
    numbers.sort(key=lambda other: float(entries[other].get(key, 0)))
    lengths = [_length(entries[other]) for other in numbers]
    times = video_index(video).times
    half = np.median(np.diff(times)) / 2 if len(times) > 1 else 0.0
    stamped = int(np.searchsorted(times, float(entries[number].get(key, 0)) - half))
    if None in lengths:
        return stamped
    counted = np.cumsum([0, *lengths])
    if counted[-1] != len(times):
        recording.note(
            f"{video.name} holds {len(times)} pictures and its episodes have {counted[-1]} rows; their starts are "
            "taken from the stamps of the metadata."
        )
        return stamped
    start = int(counted[numbers.index(number)])
    if start != stamped:
        recording.note(f"The stamps of the metadata drift from the pictures of {video.name}; they are counted.")
    return start


def _length(entry: dict) -> int | None:
    """Rows of an episode as the metadata count them, or None."""
    if "length" in entry:
        return int(entry["length"])
    if "dataset_from_index" in entry and "dataset_to_index" in entry:
        return int(entry["dataset_to_index"]) - int(entry["dataset_from_index"])
    return None


def _read(recording: LeRobotFiles, entries: dict, rows_of: Callable, number: int) -> Episode:
    entry = entries[number]
    claimed = _file(recording, entry, "data_path", "data")
    file, table, rows = rows_of(number, claimed)
    part = {key: column[rows] for key, column in table.items()}
    if recording.camera in recording.picture_columns:
        episode = recording.make(f"episode {number}", part, lambda: recording.pictures(None, file, rows))
    else:
        video = _video(recording, entry)
        if video is None:
            raise ValueError(f"it has rows and no video of {recording.camera}.")
        start = _start(recording, entries, video, number)
        episode = recording.make(f"episode {number}", part, lambda: recording.pictures(video, file, rows, start))
    if episode.frames.count < len(rows):
        raise ValueError(f"{len(rows)} rows have {episode.frames.count} pictures: its video is cut or holds another.")
    if claimed is not None and claimed != file:
        episode.notes.append(f"the metadata name {claimed.name} for its rows, which are in {file.name}.")
    if int(entry.get("length", len(rows))) != len(rows):
        episode.notes.append(f"its length is {entry['length']} in the metadata and {len(rows)} in its file.")
    first, last = entry.get("dataset_from_index"), entry.get("dataset_to_index")
    if "index" in part and first is not None and (part["index"][0], part["index"][-1] + 1) != (first, last):
        episode.notes.append(
            f"the metadata give it the rows {first} to {last}, its own index runs from {part['index'][0]} to "
            f"{part['index'][-1] + 1}."
        )
    return episode
