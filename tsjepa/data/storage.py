"""The data set on disk: one memory-mapped TensorDict a split, and a metadata file that proves it is whole."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict

from tsjepa.support.files import read_json, replace_folder, whole
from tsjepa.support.spec import PlantSpec

METADATA, JOURNAL = "metadata.json", "journal.jsonl"
FORMAT = 2


def file_sizes(folder: Path) -> dict[str, int]:
    """Bytes of every file of the data set except metadata and journal, by path relative to ``folder``."""
    return {
        path.relative_to(folder).as_posix(): path.stat().st_size
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in (METADATA, JOURNAL)
    }


def content_hash(folder: Path) -> str:
    """SHA-256 over the names and bytes of every memory-mapped tensor of the data set."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.memmap")):
        digest.update(path.relative_to(folder).as_posix().encode())
        with path.open("rb") as file:
            while block := file.read(1 << 24):
                digest.update(block)
    return digest.hexdigest()


def check_space(folder: Path, needed: int) -> None:
    """Raises OSError where the disk cannot hold ``needed`` more bytes; a full one would kill whoever writes a map."""
    free = shutil.disk_usage(folder).free + sum(path.stat().st_blocks * 512 for path in folder.rglob("*"))
    if free < needed:
        raise OSError(f"The data set needs {needed / 1e6:.0f} MB, and {folder.parent} has {free / 1e6:.0f} MB free.")


def start_split(folder: Path, trajectories: TensorDict, frame: tuple[int, int]) -> None:
    """Writes all of one split [episodes, T + 1] but the frames, of ``frame`` (H, W), for which it makes room."""
    make_map(folder, trajectories.memmap(folder), "pixels", (*trajectories.batch_size, *frame, 3), torch.uint8)


def make_map(folder: Path, stored: TensorDict, key: str, shape: Sequence[int], dtype: torch.dtype) -> None:
    """Adds a tensor of zeros to a split that is ``stored`` in ``folder``, with room for all of it on the disk.

    Raises:
        OSError: the disk has no room for it.
    """
    made = stored.make_memmap(key, shape=torch.Size(shape), dtype=dtype)
    if hasattr(os, "posix_fallocate"):
        # a map of a file without its blocks ends the process, without a word, on the first byte that no longer fits
        with (folder / f"{key}.memmap").open("r+b") as file:
            os.posix_fallocate(file.fileno(), 0, made.numel() * made.element_size())


def write_picture(path: Path, image: np.ndarray) -> None:
    """Writes an RGB picture uint8 [H, W, 3], in the format of the path's suffix.

    Raises:
        OSError: no room, no right to write, or no such folder; what was there stays.
    """
    import cv2

    # OpenCV's own writing fails without a word
    _, encoded = cv2.imencode(path.suffix, image[..., ::-1])
    with whole(path) as partial:
        partial.write_bytes(encoded.tobytes())


def publish(partial: Path, folder: Path, metadata: dict) -> None:
    """Writes a data set's metadata and renames ``partial`` to ``folder``, so that it is there whole or not at all."""
    metadata = {"format": FORMAT, **metadata, "sha256": content_hash(partial), "files": file_sizes(partial)}
    (partial / METADATA).write_text(json.dumps(metadata, indent=2) + "\n")
    replace_folder(partial, folder)
    (folder / JOURNAL).unlink(missing_ok=True)


def read_metadata(folder: str | Path) -> dict:
    """Metadata of the data set in ``folder``.

    Raises:
        FileNotFoundError: there is no data set there.
        ValueError: a file is missing or truncated, or the format is another version's.
    """
    folder = Path(folder)
    path = folder / METADATA
    if not path.is_file():
        raise FileNotFoundError(
            f"No data set in {folder}: collect one with `tsjepa collect`, or import a recording with `tsjepa import`."
        )
    try:
        metadata = read_json(path)
    except ValueError as error:
        raise ValueError(f"{path} is damaged; delete the folder and collect it anew.") from error
    if metadata.get("format") != FORMAT:
        raise ValueError(
            f"The data set in {folder} has format {metadata.get('format')}, not {FORMAT}: collect it anew."
        )
    actual = file_sizes(folder)
    for name, size in metadata["files"].items():
        if actual.get(name) != size:
            raise ValueError(
                f"The data set in {folder} is damaged: {name} has {actual.get(name, 'no')} bytes instead of {size}; "
                f"delete the folder and collect it anew."
            )
    return metadata


def spec_of(metadata: dict) -> PlantSpec:
    """Names, units and ranges of the plant, or of the recording, that a data set is of."""
    return PlantSpec.from_dict(metadata["spec"])


def open_split(folder: str | Path, split: str) -> TensorDict:
    """One split as a memory-mapped TensorDict with batch size [episodes, T + 1].

    Keys: ``pixels`` uint8 [H, W, 3], ``action`` [m] (the command applied in the slot that starts at this frame; zero in
    the last one), and where the data set has them ``state`` [n], ``expert_action`` [m] (the expert's command for the
    plant's own set-points in the same state), ``reference`` [r] (these set-points) and ``scene`` [s].

    Raises:
        FileNotFoundError, ValueError: see :func:`read_metadata`.
        KeyError: no such split.
    """
    metadata = read_metadata(folder)
    if split not in metadata["splits"]:
        raise KeyError(f"The data set in {folder} has no split {split!r}; it has {', '.join(metadata['splits'])}.")
    try:
        return TensorDict.load_memmap(Path(folder) / split, allow_pickle=False)
    except Exception as error:
        raise ValueError(
            f"The data set in {folder} is damaged: the split {split} cannot be read; delete the folder and collect it "
            "anew."
        ) from error
