"""HDF5: the layouts of robomimic, ALOHA and stable-worldmodel, flat D4RL keys, and others by naming the keys."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from tsjepa.data.readers.arrays import ACTION, ENDS_OF_EPISODES, ArrayRecording
from tsjepa.data.readers.episode import Episode, Skipped, Streams, attempt
from tsjepa.data.readers.kept_open import KeptOpen
from tsjepa.data.readers.pictures import natural
from tsjepa.support.foreign import optional, refuse_pointers

SUFFIXES = (".hdf5", ".h5", ".he5")
BEST_RATIO = 1100  # of gzip on zeros; a data set that claims more than this times its bytes was never written


class Hdf5:
    """Reader of HDF5 files; see :class:`tsjepa.data.readers.episode.Recording`.

    A group ``data`` with one group an episode is robomimic's layout, and the same groups at the top of a file are read
    likewise; ``observations/images`` in a file is ALOHA's, one file an episode; ``ep_len`` and ``ep_offset`` beside
    flat arrays are stable-worldmodel's.
    """

    @staticmethod
    def matches(path: Path) -> bool:
        if path.is_file():
            return path.suffix in SUFFIXES
        return any(file.suffix in SUFFIXES for file in path.iterdir())

    def __init__(self, path: Path, streams: Streams) -> None:
        self.h5py = optional("h5py")
        self.files = [path] if path.is_file() else sorted(
            (file for file in path.iterdir() if file.suffix in SUFFIXES), key=natural
        )  # fmt: skip
        refuse_pointers(self.files)
        self.streams, self.rate_hz = streams, streams.rate_hz
        self.recording = ArrayRecording(streams)
        self.notes, self.cameras, self.others = self.recording.notes, self.recording.cameras, self.recording.others
        self.format = "HDF5"
        self.kept = KeptOpen()
        for file in self.files:
            opened = attempt(file.name, lambda file=file: self.h5py.File(file, "r"))
            if not isinstance(opened, Skipped):
                with opened:
                    self.format = f"HDF5, {layout(opened)}"
                break

    def episodes(self) -> Iterator[Episode | Skipped]:
        """The episodes of every file."""
        for file in self.files:
            opened = attempt(file.name, lambda file=file: self.h5py.File(file, "r"))
            if isinstance(opened, Skipped):
                yield Skipped(file.name, f"it is no HDF5 file that can be read ({opened.reason.rstrip('.')}).")
                continue
            with opened:
                for name, group in self._groups(file, opened):
                    arrays = attempt(name, lambda name=name, group=group: self._arrays(name, group))
                    if isinstance(arrays, Skipped):
                        yield arrays
                    else:
                        yield from self.recording.episodes(name, arrays)

    def _groups(self, file: Path, opened) -> list[tuple[str, object]]:
        if any(key in opened for key in (ENDS_OF_EPISODES, f"meta/{ENDS_OF_EPISODES}")):
            return [(file.name, opened)]
        for parent in (opened.get("data"), opened):
            if names := groups_of_episodes(parent):
                label = "" if len(self.files) == 1 else f"{file.name} "
                return [(f"{label}{name}", parent[name]) for name in sorted(names, key=natural)]
        return [(file.name, opened)]

    def _arrays(self, name: str, group) -> dict[str, Stored]:
        """Data sets below a group by their path; a claimed size that is not in the file is refused."""
        found = {}

        def visit(key: str, item: object) -> None:
            if isinstance(item, self.h5py.Dataset) and item.shape:
                found[key] = item

        group.visititems(visit)
        for key, data in found.items():
            claimed, stored = data.size * data.dtype.itemsize, data.id.get_storage_size()
            if claimed > BEST_RATIO * stored + (1 << 20) or (data.chunks is None and claimed > stored):
                raise ValueError(f"its {key} claims the shape {data.shape} and holds {stored} bytes; it is damaged.")
        declared = group.attrs.get("num_samples")
        actions = found.get("actions")
        if isinstance(declared, (int, np.integer)) and actions is not None and declared != len(actions):
            self.notes.append(f"{name} claims {declared} samples and has {len(actions)}.")
        return {key: Stored(self.kept, data) for key, data in found.items()}


class Stored:
    """A data set [N, ...] of a file that is open only while it is read, and for as long as few others are."""

    def __init__(self, kept: KeptOpen, data) -> None:
        self.kept, self.path, self.name = kept, data.file.filename, data.name
        self.shape, self.dtype, self._open = data.shape, data.dtype, type(data.file)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: slice | Sequence[int] | np.ndarray) -> np.ndarray:
        return self.kept.get(self.path, lambda: self._open(self.path, "r"))[self.name][index]


def groups_of_episodes(parent) -> list[str]:
    """Names of the groups that hold commands of their own; none where the parent holds some itself."""
    if not hasattr(parent, "keys") or any(key in parent for key in ACTION):
        return []
    groups = {name: parent.get(name) for name in parent}
    return [name for name, group in groups.items() if hasattr(group, "keys") and any(key in group for key in ACTION)]


def layout(file) -> str:
    """Whose layout a file has."""
    if any(key in file for key in (ENDS_OF_EPISODES, f"meta/{ENDS_OF_EPISODES}")):
        return "a replay buffer"
    if groups_of_episodes(file.get("data")):
        return "robomimic's layout"
    if groups_of_episodes(file):
        return "a group an episode"
    if "observations/images" in file and "action" in file:
        return "ALOHA's layout"
    if "ep_len" in file and "ep_offset" in file:
        return "stable-worldmodel's layout"
    return "flat arrays"
