"""Folders of videos, or of numbered pictures, with commands in CSV, Parquet or JSON lines."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tsjepa.data.readers import names, pictures, video
from tsjepa.data.readers.episode import Episode, Frames, Skipped, Streams, attempt
from tsjepa.support import delimited, stamps, tables
from tsjepa.support.foreign import refuse_pointers

PICTURE = ("image", "picture", "frame_file", "image_file", "image_path")
EPISODES = ("episode_index", "episode", "episode_id", "video", "file", "filename", "clip")


class Videos:
    """Reader of loose files; see :class:`tsjepa.data.readers.episode.Recording`.

    An episode is a video, or a folder of pictures. Its rows are in the table of the same name, in the only table beside
    it, or in a table of all episodes whose column (``episode``, ``video``, ``file``, ...) names it.
    """

    @staticmethod
    def matches(path: Path) -> bool:
        if path.is_file():
            return path.suffix.lower() in video.SUFFIXES
        children = [child for child in path.iterdir() if not child.name.startswith(".")]
        below = [grandchild for child in children if child.is_dir() for grandchild in child.iterdir()]
        return any(file.suffix.lower() in (*video.SUFFIXES, *pictures.SUFFIXES) for file in [*children, *below])

    def __init__(self, path: Path, streams: Streams) -> None:
        self.path = path if path.is_dir() else path.parent
        self.streams, self.notes, self.rate_hz = streams, [], streams.rate_hz
        if path.is_file():
            files = [file for file in self.path.iterdir() if file == path or delimited.kind(file) in tables.SUFFIXES]
        else:
            files = [file for file in path.rglob("*") if file.is_file()]
        files = sorted((file for file in files if not file.name.startswith(".")), key=pictures.natural)
        self.clips = [file for file in files if file.suffix.lower() in video.SUFFIXES]
        self.folders: dict[Path, list[Path]] = {}
        for file in files:
            if file.suffix.lower() in pictures.SUFFIXES and not self.clips:
                self.folders.setdefault(file.parent, []).append(file)
        self.tables = [file for file in files if delimited.kind(file) in tables.SUFFIXES]
        refuse_pointers(self.clips or self.tables)
        self.cameras, self.others = [], []
        self.format = "folder of videos" if self.clips else "folder of pictures"
        if not self.tables:
            what = f"{len(self.clips)} videos" if self.clips else f"{sum(map(len, self.folders.values()))} pictures"
            raise ValueError(
                f"{path} holds {what} and no table of commands (CSV, Parquet or JSON lines); without commands there is "
                "nothing to import."
            )
        self._sources: list[Path] = self._of_one_camera(self.clips or list(self.folders))
        self._used: set[Path] = set()

    def _of_one_camera(self, sources: list[Path]) -> list[Path]:
        """Those of ``sources`` that show different episodes: several beside one table, each with a picture for every
        row, are views of one episode, of which the camera's is taken, or the first.

        Raises:
            ValueError: there is no camera of that name.
        """
        taken, wanted = [], self.streams.camera
        for parent in dict.fromkeys(source.parent for source in sources):
            views = [source for source in sources if source.parent == parent]
            beside = [table for table in self.tables if table.parent == parent]
            if len(beside) == 1 and len(views) > 1 and self._same_rows(beside[0], views):
                names_of = {source.name if source in self.folders else source.stem: source for source in views}
                self.cameras += [name for name in names_of if name not in self.cameras]
                if wanted is not None and wanted not in names_of:
                    raise ValueError(f"There is no camera {wanted}; there are {', '.join(names_of)}.")
                views = [names_of[wanted] if wanted is not None else views[0]]
            taken += views
        if len(self.cameras) > 1 and wanted is None:
            self.notes.append(f"It has the cameras {', '.join(self.cameras)}; the first is taken.")
        return taken

    def _same_rows(self, table: Path, sources: list[Path]) -> bool:
        """Whether the table has a row for every picture of each of ``sources``, and nothing that tells them apart."""
        if any(delimited.stem(table) in (source.name, source.stem) for source in sources):
            return False
        columns = attempt(table.name, lambda: tables.read_table(table))
        if isinstance(columns, Skipped) or not columns or any(name in columns for name in EPISODES):
            return False
        rows = len(next(iter(columns.values())))
        counts = [attempt(source.name, lambda source=source: self._count(source)) for source in sources]
        return all(isinstance(count, int) and abs(count - rows) <= 1 for count in counts)

    def _count(self, source: Path) -> int:
        return len(self.folders[source]) if source in self.folders else video.Video(source).count

    def episodes(self) -> Iterator[Episode | Skipped]:
        """One episode a video or a folder of pictures; tables that belong to none come last."""
        for source in self._sources:
            yield attempt(source.name, lambda source=source: self._episode(source))
        for table in self.tables:
            if table not in self._used:
                yield Skipped(table.name, "no video or folder of pictures belongs to this table.")

    def _episode(self, source: Path) -> Episode:
        table = self._rows_of(source)
        times = stamps.time_column(table, self.streams.time)
        skip = {times[0]} if times else set()
        action_names, action = names.columns_like(table, self.streams.action, "action", skip)
        if not action_names:
            others = [name for name, column in table.items() if column.dtype != object and name not in skip]
            raise ValueError(f"no column is called a command; say which of {', '.join(others)} are (--action).")
        listed = self._listed(table)
        state_names, state = names.columns_like(table, self.streams.state, "state", {*skip, *action_names})
        taken = {*skip, *action_names, *state_names, *PICTURE}
        self.others += [name for name in table if name not in {*taken, *self.others}]
        return Episode(
            name=source.name,
            frames=self._frames(source, listed),
            action=action,
            action_names=action_names,
            action_units=names.units_of(action_names),
            state=state if state_names else None,
            state_names=state_names,
            state_units=names.units_of(state_names),
            times=times[1] if times else None,
            paired=times is None or listed is not None,
        )

    @staticmethod
    def _listed(table: tables.Table) -> list[str] | None:
        """File names of the pictures, where the rows have a column of them."""
        column = next((column for name, column in table.items() if name in PICTURE), None)
        return None if column is None or column.dtype != object else [Path(str(cell)).name for cell in column]

    def _frames(self, source: Path, listed: list[str] | None) -> Frames:
        if source not in self.folders:
            return video.Video(source)
        files = self.folders[source]
        if listed is not None:
            known = {file.name: file for file in files}
            lost = [name for name in listed if name not in known]
            if lost:
                raise ValueError(f"{len(lost)} of the {len(listed)} pictures of its rows are not there ({lost[0]}).")
            return pictures.picture_files([known[name] for name in listed])
        labels = [file.stem for file in files]
        times = None
        if all(label.isdigit() and len(label) >= 10 for label in labels):  # since 1970
            times = stamps.as_seconds(np.array([int(label) for label in labels]), 1.0)
        return pictures.picture_files(files, times)

    def _rows_of(self, source: Path) -> tables.Table:
        """The rows that belong to a video or a folder of pictures.

        Raises:
            ValueError: none do, or nobody can tell which.
        """
        stem = source.name if source in self.folders else source.stem
        own = [table for table in self.tables if delimited.stem(table) == stem or table.parent == source]
        own = own or [table for table in self.tables if table.parent == source.parent and self._only(source)]
        if not own and len(self.tables) == 1:
            own = self.tables
        if len(own) != 1:
            which = "none" if not own else f"{len(own)} ({', '.join(table.name for table in own[:4])})"
            raise ValueError(f"of the tables {which} belong to it; call its table {stem}.csv.")
        self._used.add(own[0])
        table = tables.read_table(own[0])
        if not table or not len(next(iter(table.values()))):
            raise ValueError(f"its table {own[0].name} holds no rows.")
        key = next((name for name in EPISODES if name in table), None)
        if key is None:
            alone = own[0].parent == source.parent and self._only(source)
            if len(self._sources) > 1 and delimited.stem(own[0]) != stem and own[0].parent != source and not alone:
                raise ValueError(
                    f"{own[0].name} is one table for {len(self._sources)} episodes and has no column "
                    f"{', '.join(EPISODES[:4])} that tells them apart."
                )
            return table
        rows = self._select(table[key], source, stem, whole=delimited.stem(own[0]) == stem)
        return {name: column[rows] for name, column in table.items() if name != key}

    def _only(self, source: Path) -> bool:
        """Whether no other episode lies beside it."""
        return sum(other.parent == source.parent for other in self._sources) == 1

    def _select(self, column: np.ndarray, source: Path, stem: str, whole: bool) -> np.ndarray:
        if column.dtype == object:
            own = {source.name, stem, source.relative_to(self.path).as_posix()}
            rows = np.flatnonzero([str(cell) in own or Path(str(cell)).name in own for cell in column])
        else:
            digits = [part for part in pictures.natural(stem) if part[0] == 0]
            number = digits[-1][1] if digits else self._sources.index(source)
            rows = np.flatnonzero(column == number)
        if not len(rows) and whole:
            return np.arange(len(column))
        if not len(rows):
            raise ValueError("the table has no rows for it.")
        return rows
