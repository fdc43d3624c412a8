"""Donkeycar tubs: of version 2, catalogs of JSON lines and a folder of pictures; of version 1, a file a record."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np

from tsjepa.data.readers.episode import Episode, Skipped, Streams, attempt, ranges
from tsjepa.data.readers.names import units_of
from tsjepa.data.readers.pictures import natural, picture_files
from tsjepa.support.foreign import refuse_pointers
from tsjepa.support.tables import read_json, read_json_lines

IMAGE = "image_array"


class Donkeycar:
    """Reader of a tub; see :class:`tsjepa.data.readers.episode.Recording`. One session of the car is one episode."""

    @staticmethod
    def matches(path: Path) -> bool:
        return ((path / "manifest.json").is_file() and any(path.glob("*.catalog"))) or any(path.glob("record_*.json"))

    def __init__(self, path: Path, streams: Streams) -> None:
        self.path, self.streams, self.notes = path, streams, []
        self.rate_hz = streams.rate_hz  # a tub does not say how often it was asked to record
        second = (path / "manifest.json").is_file()
        self.format = f"Donkeycar tub v{2 if second else 1}"
        self.images = path / "images" if second else path
        self.missing, self.deleted = [], set()
        kinds, current = self._open_v2() if second else self._open_v1()
        kinds = kinds or {name: _kind(name, value) for record in self.records[:1] for name, value in record.items()}
        self.cameras = [name for name, kind in kinds.items() if kind == IMAGE]
        if not self.records:
            raise ValueError(f"{path} is a Donkeycar tub without a record.")
        if not self.cameras:
            raise ValueError(f"{path} is a Donkeycar tub without pictures; it records {', '.join(kinds)}.")
        self.camera = streams.camera or self.cameras[0]
        if self.camera not in self.cameras:
            raise ValueError(f"There is no camera {self.camera}; the tub has {', '.join(self.cameras)}.")
        # the pilot drives where the user does not: what was driven is the user's command in user mode
        self.action_names = streams.action or [
            name for name, kind in kinds.items() if kind == "float" and name.startswith("user/")
        ]
        if not self.action_names:
            raise ValueError(f"{path} records no command of the user; it records {', '.join(kinds)}.")
        self.state_names = streams.state or []
        unknown = [name for name in [*self.action_names, *self.state_names] if name not in kinds]
        if unknown:
            raise ValueError(f"{path} records no {', '.join(unknown)}; it records {', '.join(kinds)}.")
        self.others = [name for name in kinds if name not in (*self.action_names, *self.state_names, self.camera)]
        if isinstance(current, int) and current != len(self.records):
            self.notes.append(f"The manifest counts {current} records; {len(self.records)} are there.")

    def _open_v1(self) -> tuple[dict[str, str], None]:
        """Reads the records of version 1; gives the types of what they hold, as far as meta.json says."""
        self.records = []
        files = sorted(self.path.glob("record_*.json"), key=natural)
        refuse_pointers(files)
        broken = []
        for file in files:
            number = file.stem.rpartition("_")[2]
            try:
                self.records.append({**read_json(file), "_index": int(number) if number.isdigit() else -1})
            except ValueError:
                broken.append(file.name)
        if broken:
            self.notes.append(f"{len(broken)} records are no JSON ({', '.join(broken[:3])}) and are left out.")
        try:
            meta = read_json(self.path / "meta.json")
        except (OSError, ValueError):
            meta = {}
        inputs, types = meta.get("inputs"), meta.get("types")
        lists = isinstance(inputs, list) and isinstance(types, list)
        return dict(zip(map(str, inputs), types, strict=False)) if lists else {}, None

    def _open_v2(self) -> tuple[dict[str, str], object]:
        """Reads the records of version 2; gives the types of what they hold, and how many the manifest counts."""
        path = self.path
        catalogs = sorted(path.glob("*.catalog"), key=natural)
        refuse_pointers(catalogs)
        inputs, types, manifest = self._manifest(path / "manifest.json")
        there = [catalog.name for catalog in catalogs]
        self.missing = [name for name in manifest.get("paths") or [] if name not in there]
        self.deleted = set(manifest.get("deleted_indexes") or [])
        self.records, broken = [], []
        for catalog in catalogs:
            try:
                self.records += read_json_lines(catalog)
            except ValueError as error:
                broken.append(f"{catalog.name} is left out: {error}")
        self.notes += broken
        return dict(zip(inputs, types, strict=False)), manifest.get("current_index")

    @staticmethod
    def _manifest(path: Path) -> tuple[list[str], list[str], dict]:
        """Inputs, their types and the last line, which names the catalogs."""
        lines = []
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                lines.append(json.loads(line))
            except ValueError:
                lines.append(None)
        inputs, types = (line if isinstance(line, list) else [] for line in (*lines, None, None)[:2])
        last = next((line for line in reversed(lines) if isinstance(line, dict) and "paths" in line), {})
        return inputs, types, last

    def episodes(self) -> Iterator[Episode | Skipped]:
        """One episode a session; catalogs, pictures and records that are not there by name."""
        for name in self.missing:
            yield Skipped(name, "the manifest names this catalog and it is not there.")
        kept = [record for record in self.records if record.get("_index") not in self.deleted]
        if len(kept) < len(self.records):
            yield Skipped("deleted records", "the tub's owner marked them as deleted.", len(self.records) - len(kept))
        sessions = [(key, list(group)) for key, group in groupby(kept, key=lambda record: record.get("_session_id"))]
        for session, records in sessions:
            name = self.path.name if session is None else f"session {session}"
            yield attempt(name, lambda name=name, records=records: self._episode(name, records))

    def _episode(self, name: str, records: list[dict]) -> Episode:
        files, kept, lost = [], [], []
        for record in records:
            file = self.images / Path(str(record.get(self.camera))).name
            if file.is_file():
                files.append(file)
                kept.append(record)
            else:
                lost.append(int(record.get("_index", -1)))
        if not files:
            raise ValueError(f"none of its {len(records)} pictures is in {self.images.name}/.")
        action, state = (
            np.array([[_number(record.get(key)) for key in names] for record in kept], np.float32)
            for names in (self.action_names, self.state_names)
        )
        key = "_timestamp_ms" if "_timestamp_ms" in kept[0] else "milliseconds"
        stamps = np.array([_number(record.get(key)) for record in kept])
        times = stamps / 1000 if np.isfinite(stamps).all() else None
        episode = Episode(
            name=name,
            frames=picture_files(files, times),
            action=action,
            action_names=list(self.action_names),
            action_units=units_of(self.action_names),
            state=state if self.state_names else None,
            state_names=list(self.state_names),
            state_units=units_of(self.state_names),
            times=times,
            paired=True,
        )
        modes = {record.get("user/mode") for record in kept} - {"user", None}
        if modes:
            episode.notes.append(f"the pilot drove too ({', '.join(map(str, modes))}); the user's commands are taken.")
        if lost:
            episode.notes.append(f"{len(lost)} records have no picture ({ranges(lost)}) and are left out.")
        if times is None:
            episode.notes.append("some records have no time.")
        return episode


def _kind(name: str, value: object) -> str:
    """The type of an input that no list of types names."""
    if name.startswith("cam/"):
        return IMAGE
    return "float" if isinstance(value, (int, float)) and not isinstance(value, bool) else "str"


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else np.nan
