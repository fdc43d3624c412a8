"""NumPy archives: one .npz an episode, or one for all with the lengths of the episodes."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

import numpy as np

from tsjepa.data.readers.arrays import ArrayRecording
from tsjepa.data.readers.episode import Episode, Skipped, Streams, attempt
from tsjepa.data.readers.kept_open import KeptOpen
from tsjepa.data.readers.pictures import natural
from tsjepa.support.foreign import refuse_pointers

BEST_RATIO = 1032  # of deflate: a member that claims more than this times its bytes is damaged


class Npz:
    """Reader of .npz files; see :class:`tsjepa.data.readers.episode.Recording`. Nothing pickled is read."""

    format = "npz"

    @staticmethod
    def matches(path: Path) -> bool:
        return path.suffix == ".npz" if path.is_file() else any(path.glob("*.npz"))

    def __init__(self, path: Path, streams: Streams) -> None:
        self.files = [path] if path.is_file() else sorted(path.glob("*.npz"), key=natural)
        refuse_pointers(self.files)
        self.recording, self.kept = ArrayRecording(streams), KeptOpen()
        self.rate_hz, self.notes = streams.rate_hz, self.recording.notes
        self.cameras, self.others = self.recording.cameras, self.recording.others

    def episodes(self) -> Iterator[Episode | Skipped]:
        """The episodes of every file."""
        for file in self.files:
            arrays = attempt(file.stem, lambda file=file: members(file, self.kept))
            if isinstance(arrays, Skipped):
                yield arrays
            else:
                yield from self.recording.episodes(file.stem, arrays)


def members(path: Path, kept: KeptOpen) -> dict[str, Member]:
    """The arrays of an archive by name; those of objects, which only unpickling could read, are left out.

    Raises:
        ValueError: it is no archive of arrays.
    """
    found = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for info in archive.infolist():
                if info.filename.endswith(".npy"):
                    member = Member(path, info, kept)
                    if not member.dtype.hasobject:
                        found[info.filename[:-4]] = member
    except zipfile.BadZipFile as error:
        raise ValueError(f"{path.name} is no npz archive ({error}).") from error
    return found


class Member:
    """One array of an .npz, read in rows: the whole of it is never in memory unless it is asked for."""

    def __init__(self, path: Path, info: zipfile.ZipInfo, kept: KeptOpen) -> None:
        self.path, self.name, self.kept = path, info.filename, kept
        with zipfile.ZipFile(path) as archive, archive.open(info) as file:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            self.shape, self.fortran, self.dtype = read(file)
            self.start = file.tell()
        size = int(np.prod([int(side) for side in self.shape], dtype=object)) * self.dtype.itemsize
        if size > info.file_size - self.start or info.file_size > BEST_RATIO * info.compress_size + 1024:
            raise ValueError(f"{self.name} in {path.name} claims {self.shape} and is smaller; it is damaged.")

    def __len__(self) -> int:
        return self.shape[0] if self.shape else 0

    def __getitem__(self, index: slice | Sequence[int] | np.ndarray) -> np.ndarray:
        rows = np.arange(len(self))[index] if isinstance(index, slice) else np.asarray(index, dtype=np.int64)
        if self.fortran and len(self.shape) > 1:
            with np.load(self.path, allow_pickle=False) as archive:
                return archive[self.name[:-4]][rows]
        row_bytes = int(np.prod(self.shape[1:], dtype=np.int64)) * self.dtype.itemsize
        out = np.empty((len(rows), *self.shape[1:]), self.dtype)
        file = self.kept.get((self.path, self.name), self._open)
        for place, row in enumerate(rows):
            file.seek(self.start + int(row) * row_bytes)
            out[place] = np.frombuffer(file.read(row_bytes), self.dtype).reshape(self.shape[1:])
        return out

    def _open(self) -> IO[bytes]:
        with zipfile.ZipFile(self.path) as archive:
            return archive.open(self.name)  # the archive's file stays open until this one is closed
