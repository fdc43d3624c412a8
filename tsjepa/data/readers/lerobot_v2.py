"""LeRobot v2.0 and v2.1: one Parquet file and one MP4 a camera for each episode."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tsjepa.data.readers.episode import Episode, Skipped, ranges
from tsjepa.data.readers.lerobot_files import LeRobotFiles
from tsjepa.support.foreign import reason
from tsjepa.support.tables import read_json_lines

EPISODE_FILE = re.compile(r"episode_(\d+)$")


def list_episodes(recording: LeRobotFiles) -> list[tuple[str, Callable[[], Episode] | Skipped]]:
    """Episodes by the files that are there; those that only the metadata know come last, as one entry."""
    rows = {_number(file): file for file in recording.data_files if _number(file) is not None}
    videos = {_number(file): file for file in recording.video_files if recording.camera in file.parts}
    videos.pop(None, None)
    lengths = _lengths(recording)
    _compare(recording, rows, videos, lengths)
    episodes: list[tuple[str, Callable[[], Episode] | Skipped]] = []
    for number, file in sorted(rows.items()):
        name = f"episode {number}"
        pictures = recording.camera in recording.picture_columns or (recording.camera, file.stem) in recording.folders
        if not pictures and number not in videos:
            why = f"it has rows and no video of {recording.camera}."
            episodes.append((name, Skipped(name, why)))
            continue
        episodes.append((name, lambda number=number, file=file: _read(recording, number, file, videos, lengths)))
    claimed = set(lengths) or set(range(_count(recording.info.get("total_episodes"))))
    absent = sorted(claimed - set(rows))
    if absent:
        name = f"episodes {ranges(absent)}"
        episodes.append((name, Skipped(name, "the metadata name them and their rows are not there.", len(absent))))
    return episodes


def _number(file: Path) -> int | None:
    match = EPISODE_FILE.search(file.stem)
    return int(match[1]) if match else None


def _count(value: object) -> int:
    return value if isinstance(value, int) and 0 <= value <= 1_000_000 else 0


def _lengths(recording: LeRobotFiles) -> dict[int, int | None]:
    path = recording.path / "meta" / "episodes.jsonl"
    if not path.is_file():
        recording.notes.append("meta/episodes.jsonl is missing; the episodes are those of the files.")
        return {}
    try:
        rows = read_json_lines(path)
    except ValueError as error:
        recording.notes.append(f"meta/episodes.jsonl cannot be used: {reason(error)}")
        return {}
    return {row["episode_index"]: row.get("length") for row in rows if isinstance(row.get("episode_index"), int)}


def _compare(recording: LeRobotFiles, rows: dict, videos: dict, lengths: dict) -> None:
    """Notes where the metadata and the files disagree."""
    info, notes = recording.info, recording.notes
    for key, there in (("total_episodes", len(rows)), ("total_videos", len(recording.video_files))):
        if key in info and info[key] != there:
            notes.append(f"{key} is {info[key]}; {there} are there.")
    for split, span in (info.get("splits") or {}).items() if isinstance(info.get("splits"), dict) else ():
        last = str(span).rpartition(":")[2]
        if last.isdigit() and rows and int(last) > max(rows) + 1:
            notes.append(f"The split {split} is {span}; the last episode is {max(rows)}.")
    for key, files, extra in (("data_path", rows, {}), ("video_path", videos, {"video_key": recording.camera})):
        wrong = [number for number, file in sorted(files.items()) if _resolve(recording, key, number, extra) != file]
        if wrong and isinstance(info.get(key), str):
            notes.append(
                f"{key} does not lead to the file of {len(wrong)} of {len(files)} episodes ({ranges(wrong)}); "
                "the files are taken where they are."
            )


def _resolve(recording: LeRobotFiles, key: str, number: int, extra: dict) -> Path | None:
    size = _count(recording.info.get("chunks_size")) or 1000
    try:
        words = {"episode_chunk": number // size, "episode_index": number, **extra}
        return recording.path / recording.info[key].format(**words)
    except (KeyError, IndexError, ValueError, AttributeError, TypeError):
        return None


def _read(recording: LeRobotFiles, number: int, file: Path, videos: dict[int, Path], lengths: dict) -> Episode:
    table = recording.read_rows(file)
    count = len(next(iter(table.values())))
    episode = recording.make(
        f"episode {number}", table, lambda: recording.pictures(videos.get(number), file, np.arange(count))
    )
    if "episode_index" in table and not (table["episode_index"] == number).all():
        others = sorted({int(index) for index in table["episode_index"] if np.isfinite(index)} - {number})
        episode.notes.append(f"{file.name} holds rows of the episode {ranges(others)} by their episode_index.")
    if lengths.get(number) not in (None, count):
        episode.notes.append(f"its length is {lengths[number]} in the metadata and {count} in its file.")
    return episode
