"""Pictures of a LeRobot data set that are no video: coded in the rows, or files that the rows or folders name."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tsjepa.data.readers.kept_open import KeptOpen
from tsjepa.data.readers.pictures import SUFFIXES, CodedPictures
from tsjepa.support.foreign import optional

Folders = dict[tuple[str, str], list[Path]]


def has_pictures(kind) -> bool:
    """Whether a column of this Arrow type holds coded pictures, or a struct of their bytes and path."""
    types = optional("pyarrow").types
    if types.is_struct(kind):
        return "bytes" in {kind.field(place).name for place in range(kind.num_fields)}
    return types.is_binary(kind) or types.is_large_binary(kind)


def picture_folders(path: Path, files: Iterable[Path]) -> Folders:
    """Picture files by camera and episode, of ``images/CAMERA/episode_000000/frame_000000.png``."""
    folders: Folders = {}
    for file in files:
        if (
            file.suffix.lower() in SUFFIXES
            and file.parent.name.startswith("episode_")
            and path / "images" in file.parents
        ):
            folders.setdefault((file.parent.parent.name, file.parent.name), []).append(file)
    return folders


def row_pictures(root: Path, file: Path, column: str, rows: np.ndarray, kept: KeptOpen) -> CodedPictures:
    """Pictures of a Parquet column, one row group in memory at a time.

    A cell holds the coded bytes, or the path of a file below ``root``.
    """
    loaded: dict[int, list] = {}

    def opened():
        return kept.get(file, lambda: optional("pyarrow.parquet").ParquetFile(file))

    metadata = opened().metadata
    ends = np.cumsum([metadata.row_group(group).num_rows for group in range(metadata.num_row_groups)])

    def fetch(index: int) -> tuple[bytes, str]:
        row = int(rows[index])
        group = int(np.searchsorted(ends, row, side="right"))
        if group not in loaded:
            loaded.clear()
            loaded[group] = opened().read_row_group(group, columns=[column])[column].to_pylist()
        cell = loaded[group][row - (int(ends[group - 1]) if group else 0)]
        data, name = (cell.get("bytes"), cell.get("path")) if isinstance(cell, dict) else (cell, None)
        if data is None and isinstance(name, str):
            return _below(root, name), name
        if not isinstance(data, bytes):
            raise ValueError(f"row {row} of {file.name} has no picture in {column}.")
        return data, f"row {row} of {file.name}"

    pictures = CodedPictures(len(rows), fetch, "coded in the rows", release=loaded.clear)
    pictures.close()  # of its first picture: all episodes are opened before one is read
    return pictures


def _below(root: Path, name: str) -> bytes:
    """Bytes of a file that a row names; nothing outside the recording is read."""
    file = (root / name).resolve()
    if root.resolve() not in file.parents or not file.is_file():
        raise ValueError(f"the picture {name}, which a row names, is not there.")
    return file.read_bytes()
