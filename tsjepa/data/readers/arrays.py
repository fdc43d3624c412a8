"""Episodes from arrays that have names, whether HDF5 or npz holds them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import pairwise

import numpy as np

from tsjepa.data.readers.episode import Episode, Skipped, Streams, attempt
from tsjepa.data.readers.names import units_of
from tsjepa.data.readers.pictures import CHANNELS, ArrayPictures, CodedPictures
from tsjepa.support.stamps import as_seconds, slow_note, wanted_times

PICTURES = re.compile(r"(^|/)(pixels|images?|rgb|frames?|video)\d*($|/)|(image|rgb|pixels|cam\w*)\d*$", re.IGNORECASE)
ACTION = ("action", "actions", "command", "commands", "control", "u")
STATE = ("state", "states", "qpos", "observation.state", "observations/qpos", "proprio", "obs/state")
TIME = ("time", "times", "timestamp", "timestamps", "t", "time_s")
ENDS_OF_EPISODES = "episode_ends"  # of a replay buffer: the row after each episode's last
INDICES = ("episode_index", "episode_idx", "ep_idx", "episode_id", "episode", "traj_id", "traj_index", "traj_idx")
LENGTHS = (("ep_len", "ep_offset"), ("episode_lengths", "episode_starts"))
ENDS = (("terminals", "timeouts"), ("dones",), ("terminated", "truncated"), ("terminals",))


class ArrayRecording:
    """Finds pictures, commands, state and times among named arrays and cuts them into episodes."""

    def __init__(self, streams: Streams) -> None:
        self.streams, self.notes = streams, []
        self.cameras: list[str] = []
        self.others: list[str] = []

    def episodes(self, name: str, arrays: Mapping[str, object]) -> Iterator[Episode | Skipped]:
        """Episodes of the arrays that one file or group holds.

        Args:
            name: of the file or group.
            arrays: array-likes by name, read only in slices.
        """
        found = attempt(name, lambda: self._find(arrays))
        if isinstance(found, Skipped):
            yield found
            return
        camera, action_keys, state_keys, time_key = found
        spans = attempt(name, lambda: self._spans(arrays, len(arrays[action_keys[0]])))
        if isinstance(spans, Skipped):
            yield spans
            return
        for number, (first, last) in enumerate(spans):
            label = name if len(spans) == 1 else f"{name} episode {number}"
            yield attempt(
                label,
                lambda label=label, first=first, last=last: self._episode(
                    label, arrays, camera, action_keys, state_keys, time_key, first, last, whole=len(spans) == 1
                ),
            )

    def _find(self, arrays: Mapping[str, object]) -> tuple[str, list[str], list[str], str | None]:
        shapes = {key: tuple(array.shape) for key, array in arrays.items()}
        empty = [key for key, shape in shapes.items() if shape and shape[0] == 0]
        if shapes and len(empty) == len([key for key, shape in shapes.items() if shape]):
            listed = ", ".join(f"{key} {shapes[key]}" for key in empty)
            raise ValueError(f"every array is of length zero ({listed}): it holds no rows.")
        listed = ", ".join(f"{key} {shape}" for key, shape in shapes.items()) or "nothing"
        cameras = [key for key, array in arrays.items() if self._is_pictures(key, array)]
        self.cameras += [key for key in cameras if key not in self.cameras]
        for wanted in [self.streams.camera, *(self.streams.action or []), *(self.streams.state or [])]:
            if wanted is not None and wanted not in arrays:
                raise ValueError(f"there is no array {wanted}; there are {listed}.")
        if not cameras and self.streams.camera is None:
            raise ValueError(f"it has no pictures among {listed}: name the array of pictures (--camera).")
        action_keys = self.streams.action or _named(ACTION, shapes)
        if not action_keys:
            raise ValueError(f"it has no commands among {listed}: name the array of commands (--action).")
        state_keys = self.streams.state or _named(STATE, shapes)
        time_key = self.streams.time or next(
            (key for key in TIME if shapes.get(key) and shapes[key][1:] in ((), (1,))), None
        )
        if len(self.cameras) > 1 and self.streams.camera is None:
            note = f"It has the cameras {', '.join(self.cameras)}; the first is taken."
            self.notes += [note] if note not in self.notes else []
        taken = {self.streams.camera or cameras[0], *action_keys, *state_keys, time_key}
        others = [f"{key} {tuple(array.shape[1:])} {array.dtype}" for key, array in arrays.items() if key not in taken]
        self.others += [other for other in others if other not in self.others]
        return self.streams.camera or cameras[0], action_keys, state_keys, time_key

    @staticmethod
    def _is_pictures(key: str, array: object) -> bool:
        if len(array.shape) == 4:
            return bool({*CHANNELS} & {array.shape[1], array.shape[3]}) and array.dtype.kind in "uf"
        if len(array.shape) == 3:
            return array.dtype == np.uint8 and bool(PICTURES.search(key))
        coded = len(array.shape) in (1, 2) and (
            array.dtype == np.uint8 or array.dtype.hasobject or array.dtype.kind == "S"
        )
        return coded and bool(PICTURES.search(key))

    def _spans(self, arrays: Mapping[str, object], rows: int) -> list[tuple[int, int]]:
        """First and last row (exclusive) of every episode.

        Raises:
            ValueError: the lengths that the file states do not fit its rows.
        """
        for lengths, starts in LENGTHS:
            if lengths in arrays:
                length = _whole(arrays[lengths][:], lengths)
                start = _whole(arrays[starts][:], starts) if starts in arrays else length.cumsum() - length
                spans = [(int(at), int(at + size)) for at, size in zip(start, length, strict=False) if size > 0]
                if any(first < 0 or last > rows for first, last in spans) or len(start) != len(length):
                    raise ValueError(f"its {lengths} and {starts} reach beyond its {rows} rows.")
                return spans
        for key in arrays:
            if key.rpartition("/")[2] == ENDS_OF_EPISODES:
                bounds = [0, *_whole(arrays[key][:], key).tolist()]
                if bounds != sorted(bounds) or bounds[-1] > rows:
                    raise ValueError(f"its {key} do not rise to its {rows} rows.")
                return [(first, last) for first, last in pairwise(bounds) if last > first]
        index = next((key for key in arrays if key.rpartition("/")[2] in INDICES and len(arrays[key]) == rows), None)
        if index is not None:
            steps = np.flatnonzero(np.diff(_whole(arrays[index][:], index))) + 1
            return list(pairwise([0, *steps.tolist(), rows]))
        for keys in ENDS:
            if all(key in arrays and len(arrays[key]) == rows for key in keys):
                ends = np.any([np.asarray(arrays[key][:]).ravel()[:rows] != 0 for key in keys], axis=0)
                bounds = [0, *(np.flatnonzero(ends) + 1).tolist(), rows]
                return [(first, last) for first, last in pairwise(bounds) if last > first]
        return [(0, rows)]

    def _episode(self, label, arrays, camera, action_keys, state_keys, time_key, first, last, whole) -> Episode:
        action_names, action = self._values(arrays, action_keys, first, last)
        state_names, state = self._values(arrays, state_keys, first, last)
        times, notes = None, []
        if time_key:
            key, scale = wanted_times(time_key, arrays)
            column = np.asarray(arrays[key][first:last]).ravel()
            times, notes = as_seconds(column, scale or 1.0), slow_note(time_key, column)
        pictures = arrays[camera]
        # N + 1 pictures with N commands: only where the file holds one episode can the last picture be told
        count = len(pictures) if whole else last - first
        if len(pictures.shape) >= 3 or pictures.dtype.kind == "f":
            frames = ArrayPictures(pictures, first, count)
        else:
            frames = CodedPictures(
                count, lambda index: (_bytes(pictures[[first + index]][0]), f"picture {index}"), "jpeg"
            )
        return Episode(
            name=label,
            frames=frames,
            action=action,
            action_names=action_names,
            action_units=units_of(action_names),
            state=state if state_names else None,
            state_names=state_names,
            state_units=units_of(state_names),
            times=times,
            paired=True,
            notes=notes,
        )

    @staticmethod
    def _values(arrays, keys: list[str], first: int, last: int) -> tuple[list[str], np.ndarray]:
        names, parts = [], []
        for key in keys:
            part = np.asarray(arrays[key][first:last], dtype=np.float32)
            part = part.reshape(len(part), -1)
            names += [key] if part.shape[1] == 1 else [f"{key}_{column}" for column in range(part.shape[1])]
            parts.append(part)
        rows = {len(part) for part in parts}
        if len(rows) > 1:
            raise ValueError(f"{', '.join(keys)} have {min(rows)} to {max(rows)} rows.")
        return names, np.concatenate(parts, axis=1) if parts else np.zeros((0, 0), np.float32)


def _named(names: tuple[str, ...], shapes: Mapping[str, tuple]) -> list[str]:
    """The first array of one of the names, at the top or else anywhere below."""
    there = [name for name in names if shapes.get(name)]
    below = [key for name in names for key in shapes if key.rpartition("/")[2] == name and shapes[key]]
    return (there or below)[:1]


def _whole(values: np.ndarray, name: str) -> np.ndarray:
    """Whole numbers [N] of an array of them."""
    values = np.asarray(values).ravel()
    if values.dtype.kind not in "iuf" or not np.isfinite(values).all() or (np.abs(values) > 2**53).any():
        raise ValueError(f"its {name} are no whole numbers.")
    return values.astype(np.int64)


def _bytes(cell: object) -> bytes:
    """Coded bytes of a padded row of uint8, of a row of varying length, or of a string."""
    return bytes(cell) if isinstance(cell, bytes) else np.asarray(cell, dtype=np.uint8).tobytes()
