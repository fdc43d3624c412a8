"""The files of a LeRobot data set of any version."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from tsjepa.data.readers.episode import Episode, Frames, Skipped, Streams, attempt
from tsjepa.data.readers.kept_open import KeptOpen
from tsjepa.data.readers.lerobot_pictures import has_pictures, picture_folders, row_pictures
from tsjepa.data.readers.names import flat_names, units_of
from tsjepa.data.readers.pictures import natural, picture_files
from tsjepa.data.readers.video import Video
from tsjepa.support.delimited import NUMBER
from tsjepa.support.foreign import optional, refuse_pointers
from tsjepa.support.tables import parquet_rows, read_json, read_table

PREFIX = "observation.images."
KEYS = {"action": ("action", "actions"), "state": ("observation.state", "state", "observation.states")}


class LeRobotFiles:
    """The part of a reader of LeRobot data sets that all their versions share; a subclass sets ``_episodes``."""

    def __init__(self, path: Path, streams: Streams) -> None:
        self.path, self.streams, self.notes, self.kept = path, streams, [], KeptOpen()
        files = [file for file in sorted(path.rglob("*"), key=natural) if file.is_file()]
        self.data_files = [file for file in files if file.suffix == ".parquet" and (path / "data") in file.parents]
        refuse_pointers(self.data_files)
        self.info = read_json(path / "meta" / "info.json")
        self.video_files = [file for file in files if file.suffix == ".mp4"]
        self.folders = picture_folders(path, files)
        version = str(self.info.get("codebase_version") or "")
        self.features = self.info.get("features")
        self.features = self.features if isinstance(self.features, dict) else {}
        if not self.data_files:
            lack = [word for word, there in (("version", version), ("features", self.features)) if not there]
            raise ValueError(
                f"{path} looks like a LeRobot data set but has no rows (no Parquet file under data/)"
                + (f", and its info.json names no {' and no '.join(lack)}" if lack else "")
                + "; without commands there is nothing to import."
            )
        self.columns, self.picture_columns = self._columns()
        self.keys = {kind: getattr(streams, kind) or self._default_keys(kind) for kind in KEYS}
        layout = "v3.0" if (path / "meta" / "episodes").is_dir() else "v2.1"
        if layout == "v2.1" and not any(file.stem.startswith("episode_") for file in self.data_files):
            raise ValueError(
                f"{path} has no meta/episodes, and its rows are in {self.data_files[0].name} instead of a file an "
                "episode: nobody can tell where an episode starts in a video."
            )
        known = version.startswith(("v2.", "v3."))
        if not known:
            self.notes.append(
                f"info.json names the version {version or 'nothing'}; the files are laid out as {layout}."
            )
        elif version[:2] != layout[:2]:
            self.notes.append(f"info.json says {version}, but the files are laid out as {layout}.")
        self.has_v3_layout = layout == "v3.0"
        self.format = f"LeRobot {version if known and version[:2] == layout[:2] else layout}"
        rate = self.info.get("fps")
        rate = float(rate) if isinstance(rate, str) and NUMBER.fullmatch(rate) else rate
        self.rate_hz = float(rate) if isinstance(rate, (int, float)) and 0 < rate < 1e6 else None
        if self.rate_hz is None:
            self.notes.append(f"info.json claims {rate!r} frames a second.")
        self.cameras = self._cameras()
        self.camera = self._camera()
        taken = {*self.wanted_columns(), self.camera}
        self.others = [name for name in dict.fromkeys([*self.columns, *self.cameras]) if name not in taken]

    def _columns(self) -> tuple[list[str], list[str]]:
        """Columns of the first file that can be read, and those of them that hold pictures."""
        failed = None
        for file in self.data_files:
            try:
                parquet_rows(file)
                schema = optional("pyarrow.parquet").read_schema(file)
                return schema.names, [field.name for field in schema if has_pictures(field.type)]
            except ValueError as error:
                failed = failed or error
        raise failed

    def _default_keys(self, kind: str) -> list[str]:
        """Columns of the command or the state: the usual one, or its parts, each a column."""
        for key in KEYS[kind]:
            if key in self.columns:
                return [key]
            if parts := [name for name in self.columns if name.startswith(key + ".")]:
                self.notes.append(f"Its {kind} is in the columns {', '.join(parts)}.")
                return parts
        return []

    def _cameras(self) -> list[str]:
        there = dict.fromkeys(
            part for file in self.video_files for part in file.relative_to(self.path).parts if part in self._declared()
        )
        for file in self.video_files:  # a camera that only the folders know
            there.update(dict.fromkeys(part for part in file.relative_to(self.path).parts if part.startswith(PREFIX)))
        there.update(dict.fromkeys(camera for camera, _ in self.folders))
        there.update(dict.fromkeys(self.picture_columns))
        for name, feature in self._declared().items():
            if name not in there:
                shape = feature.get("shape")
                self.notes.append(f"The camera {name} ({shape}) is declared and has no file.")
        return list(there)

    def _declared(self) -> dict[str, dict]:
        return {
            name: feature
            for name, feature in self.features.items()
            if isinstance(feature, dict) and feature.get("dtype") in ("video", "image")
        }

    def _camera(self) -> str:
        wanted = self.streams.camera
        if not self.cameras:
            raise ValueError(f"{self.path} has no pictures: no MP4 under videos/ and no column of images.")
        if wanted is None:
            taken = max(self.cameras, key=self._files_of)  # the first of those that miss the fewest episodes
            if len(self.cameras) > 1:
                self.notes.append(f"It has the cameras {', '.join(self.cameras)}; {taken} is taken.")
            return taken
        for name in (wanted, PREFIX + wanted):
            if name in self.cameras:
                return name
        raise ValueError(f"There is no camera {wanted}; the files have {', '.join(self.cameras)}.")

    def _files_of(self, camera: str) -> int:
        """How many files hold the pictures of a camera."""
        if camera in self.picture_columns:
            return len(self.data_files)
        return sum(camera in file.parts for file in self.video_files) + sum(key[0] == camera for key in self.folders)

    def episodes(self) -> Iterator[Episode | Skipped]:
        """The episodes that have rows and pictures; the others by name, with the reason."""
        for name, read in self._episodes:
            yield read if isinstance(read, Skipped) else attempt(name, read)

    def make(self, name: str, table: dict[str, np.ndarray], frames: Callable[[], Frames]) -> Episode:
        """An episode from its rows and its pictures."""
        names = {}
        values = {}
        for kind, wanted in self.keys.items():
            missing = [key for key in wanted if key not in table]
            if missing:
                raise ValueError(f"its rows have no column {', '.join(missing)}; they have {', '.join(self.columns)}.")
            names[kind], values[kind] = self._values(wanted, table)
        if not names["action"]:
            raise ValueError(f"its rows have no column action; they have {', '.join(self.columns)} (--action).")
        times = table.get(self.streams.time or "timestamp")
        episode = Episode(
            name=name,
            frames=frames(),
            action=values["action"],
            action_names=names["action"],
            action_units=units_of(names["action"]),
            state=values["state"] if names["state"] else None,
            state_names=names["state"],
            state_units=units_of(names["state"]),
            times=None if times is None else times.astype(np.float64),
            paired=True,
        )
        self._compare(episode)
        return episode

    def _values(self, keys: list[str], table: dict[str, np.ndarray]) -> tuple[list[str], np.ndarray]:
        names, parts = [], []
        for key in keys:
            if table[key].dtype == object:
                raise ValueError(f"its column {key} holds no numbers.")
            part = table[key].astype(np.float32)
            part = part[:, None] if part.ndim == 1 else part
            feature = self.features.get(key)
            feature = feature if isinstance(feature, dict) else {}
            shape = feature.get("shape")
            if shape and list(shape) != [part.shape[1]]:
                self.note(f"info.json gives {key} the shape {shape}, the rows have {part.shape[1]} numbers.")
            names += flat_names(feature.get("names"), part.shape[1], key)
            parts.append(part)
        return names, np.concatenate(parts, axis=1) if parts else np.zeros((0, 0), np.float32)

    def _compare(self, episode: Episode) -> None:
        frames, shape = episode.frames, (self.features.get(self.camera) or {}).get("shape")
        if shape and sorted(shape[:3]) != sorted([frames.height, frames.width, 3]):
            self.note(f"info.json gives {self.camera} the shape {shape}, the pictures are "
                       f"{frames.height} x {frames.width}.")  # fmt: skip
        if abs(frames.count - len(episode.action)) > 1:
            episode.notes.append(f"{frames.count} pictures stand beside {len(episode.action)} rows.")

    def note(self, text: str) -> None:
        """Says something about the whole recording, once."""
        if text not in self.notes:
            self.notes.append(text)

    def pictures(self, file: Path | None, rows_file: Path, rows: np.ndarray, first: int = 0) -> Frames:
        """Pictures of one episode: of the video from frame ``first`` on, or of the rows' own column."""
        if file is not None:
            return Video(file, first, len(rows) if first or self.has_v3_layout else None)
        if self.camera in self.picture_columns:
            return row_pictures(self.path, rows_file, self.camera, rows, self.kept)
        return picture_files(self.folders[self.camera, rows_file.stem])

    def wanted_columns(self) -> list[str]:
        """Columns that an episode needs, without the pictures."""
        keys = [*self.keys["action"], *self.keys["state"]]
        keys += [self.streams.time or "timestamp", "episode_index", "frame_index", "index"]
        return [key for key in dict.fromkeys(keys) if key in self.columns]

    def read_rows(self, file: Path) -> dict[str, np.ndarray]:
        """The wanted columns of a Parquet file.

        Raises:
            ValueError: it holds no rows or cannot be read.
        """
        there = optional("pyarrow.parquet").read_schema(file).names if parquet_rows(file) else []
        if not there:
            raise ValueError(f"{file.name} holds no rows.")
        table = read_table(file, [key for key in self.wanted_columns() if key in there])
        values = {*self.keys["action"], *self.keys["state"]}
        return {key: column if key in values else _single(column) for key, column in table.items()}


def _single(column: np.ndarray) -> np.ndarray:
    """Numbers [rows] of a column that some writers fill with lists of one number."""
    return column.ravel() if column.ndim == 2 and column.shape[1] == 1 else column
