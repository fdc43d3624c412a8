"""The data set on disk: one memory-mapped TensorDict a split, and a metadata file that proves it is whole."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from tensordict import TensorDict

from tsjepa.support.files import replace_folder

METADATA, JOURNAL = "metadata.json", "journal.jsonl"
FORMAT = 1


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
            f"No data set in {folder}: collect one with `tsjepa collect --config recipes/data.yaml`."
        )
    try:
        metadata = dict(json.loads(path.read_text()))
    except (ValueError, TypeError) as error:
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


def open_split(folder: str | Path, split: str) -> TensorDict:
    """One split as a memory-mapped TensorDict with batch size [episodes, T + 1].

    Keys: ``pixels`` uint8 [H, W, 3], ``state`` [4], ``action`` [1] (the command applied in the slot that starts at this
    frame; zero in the last one), ``expert_action`` [1] (the expert's command for x_d = 0 in the same state),
    ``colors`` [2, 3].

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
