"""Readers of recordings that others made, one file a format; each yields the same small typed episode."""

from __future__ import annotations

import os
from pathlib import Path

from tsjepa.data.readers.episode import Episode, Frames, Recording, Skipped, Streams
from tsjepa.support.delimited import kind
from tsjepa.support.description import load_named
from tsjepa.support.foreign import reason
from tsjepa.support.tables import SUFFIXES

# In the order in which a folder is tried: a folder of videos looks like the least.
READERS = (
    "tsjepa.data.readers.lerobot.LeRobot",
    "tsjepa.data.readers.donkeycar.Donkeycar",
    "tsjepa.data.readers.rosbag.RosBag",
    "tsjepa.data.readers.hdf5.Hdf5",
    "tsjepa.data.readers.npz.Npz",
    "tsjepa.data.readers.videos.Videos",
)
DEEPEST, MOST_FOLDERS = 5, 5000  # of the search below a folder that is no recording itself

__all__ = ["READERS", "Episode", "Frames", "Recording", "Skipped", "Streams", "UnknownFormat", "open_recording"]


class UnknownFormat(ValueError):
    """No reader knows what this is."""


def open_recording(path: str | Path, streams: Streams | None = None, reader: str | None = None) -> Recording:
    """The recording at ``path``, or the only one below it.

    Args:
        path: file or folder.
        streams: which of its streams are wanted.
        reader: class path of a reader, instead of telling the format from the files; it is imported, whosever it is.

    Raises:
        FileNotFoundError: there is nothing.
        ValueError: no reader knows it, several recordings lie below, or it cannot be used; one sentence.
        ModuleNotFoundError: the package that reads it is not installed.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"There is nothing at {path}.")
    streams = streams or Streams()
    place, kind = (path, load_named("reader", reader, trusted=True)) if reader else find_recording(path)
    try:
        return kind(place, streams)
    except (MemoryError, ModuleNotFoundError):
        raise
    except Exception as error:  # a stranger's file fails in as many ways as there are libraries
        raise ValueError(reason(error)) from error


def find_recording(path: Path) -> tuple[Path, type[Recording]]:
    """Where the recording is and which reader reads it: ``path`` itself, or the only recording below it.

    Raises:
        ValueError: there is none, or there are several.
    """
    readers = [load_named("reader", name) for name in READERS]
    certain, loose = readers[:-1], readers[-1]
    for reader in certain:
        if reader.matches(path):
            return path, reader
    below = [(folder, reader) for folder in _folders(path) for reader in certain if reader.matches(folder)]
    # a recording within a recording is a part of it
    below = [found for found in below if not any(other[0] in found[0].parents for other in below)]
    if len(below) > 1:
        names = ", ".join(str(folder.relative_to(path)) for folder, _ in below[:8])
        raise ValueError(f"{path} holds {len(below)} recordings ({names}): name one of them.")
    if below:
        return below[0]
    if loose.matches(path):
        return path, loose
    for folder in _folders(path):
        if loose.matches(folder):
            return path if _has_table(path) else folder, loose
    raise UnknownFormat(
        f"{path} is no recording that is known: it is neither a LeRobot data set, a Donkeycar tub, a ROS bag, an HDF5 "
        "or npz file, nor a folder of videos or pictures with a table of commands."
    )


def _has_table(path: Path) -> bool:
    """Whether a table lies in the folder itself, so that pictures further below belong to it."""
    return any(kind(file) in SUFFIXES for file in path.iterdir() if file.is_file())


def _folders(path: Path) -> list[Path]:
    """Folders below ``path``, the nearest first, without hidden ones."""
    if not path.is_dir():
        return []
    found, level = [], [path]
    for _ in range(DEEPEST):
        level = [
            Path(entry.path)
            for folder in level
            for entry in sorted(os.scandir(folder), key=lambda entry: entry.name)
            if entry.is_dir() and not entry.name.startswith(".")
        ]
        found += level
        if len(found) > MOST_FOLDERS:
            break
    return found[:MOST_FOLDERS]
