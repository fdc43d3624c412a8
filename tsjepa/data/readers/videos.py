"""Folders of videos, or of numbered pictures, with commands in CSV, Parquet or JSON lines."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tsjepa.data.readers import names, numbered, pictures, video
from tsjepa.data.readers.episode import Episode, Frames, Skipped, Streams, attempt, ranges
from tsjepa.support import delimited, stamps, tables
from tsjepa.support.foreign import refuse_pointers

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
        others = [file for file in self.tables if delimited.kind(file) == ".json" and not self._is_table(file)]
        self.notes += [f"{file.name} is no table of rows and is left out." for file in others]
        self.tables = [file for file in self.tables if file not in others]
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

    @staticmethod
    def _is_table(file: Path) -> bool:
        """Whether a JSON file holds rows, and not settings or a calibration."""
        rows = attempt(file.name, lambda: tables.read_json_rows(file))
        return not isinstance(rows, Skipped) and len(rows) > 1

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
        if isinstance(columns, Skipped) or not columns or self._key(columns):
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
        listed, shown = self._listed(table)
        notes: list[str] = []
        if source in self.folders and listed is None and self.folders[source]:
            rows = numbered.rows_of_pictures(self.folders[source], table)
            if rows is not None:
                table, notes = self._take(table, rows)
        times = stamps.time_column(table, self.streams.time)
        skip = {times[0]} if times else set()
        slow = stamps.slow_note(self.streams.time or times[0], table[times[0]]) if times else []
        action_names, action = names.columns_like(table, self.streams.action, "action", skip)
        if not action_names:
            others = [name for name, column in table.items() if column.dtype != object and name not in skip]
            raise ValueError(f"no column is called a command; say which of {', '.join(others)} are (--action).")
        state_names, state = names.columns_like(table, self.streams.state, "state", {*skip, *action_names})
        taken = {*skip, *action_names, *state_names, *shown}
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
            paired=times is None or listed is not None or bool(notes),
            notes=[*notes, *slow],
        )

    def _take(self, table: tables.Table, rows: np.ndarray) -> tuple[tables.Table, list[str]]:
        """Those rows that have a picture, and what is said about the others; numbered rows have times by their rate."""
        count = len(next(iter(table.values())))
        lost = sorted(set(range(count)) - set(rows.tolist()))
        note = f"{len(lost)} of {count} rows have no picture ({ranges(lost)}) and are left out." if lost else (
            "its pictures stand in the order of their numbers, the rows in another."
        )  # fmt: skip
        if stamps.time_column(table, self.streams.time) is None and lost:
            if not self.streams.rate_hz:
                raise ValueError(f"{note[:-1]}; name the column of their times (--time), or say how many there are a "
                                 "second (--rate_hz).")  # fmt: skip
            table = {**table, "time": np.arange(count) / self.streams.rate_hz}
        return {name: column[rows] for name, column in table.items()}, [note]

    def _listed(self, table: tables.Table) -> tuple[list[str] | None, list[str]]:
        """File names of the camera's pictures, where the rows have a column of them, and all such columns."""
        columns, wanted = numbered.picture_columns(table), self.streams.camera
        if wanted is not None and wanted not in (columns or self.cameras):
            there = f"there are {', '.join(columns)}" if columns else "its episodes have one each, so leave it out"
            raise ValueError(f"There is no camera {wanted}; {there}.")
        if not columns:
            return None, []
        if len(columns) > 1:
            self.cameras += [name for name in columns if name not in self.cameras]
            note = f"It has the cameras {', '.join(columns)}; the first is taken."
            self.notes += [note] if note not in self.notes and wanted is None else []
        return [numbered.file_name(cell) for cell in table[wanted or columns[0]]], columns

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
        times = numbered.times_in_names(files)
        if times is not None:
            order = np.argsort(times, kind="stable")
            files, times = [files[place] for place in order], times[order]
        return pictures.picture_files(files, times)

    @staticmethod
    def _key(table: tables.Table) -> str | None:
        """The column that tells episodes apart."""
        shown = numbered.picture_columns(table)
        return next((name for name in EPISODES if name in table and name not in shown), None)

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
        key = self._key(table)
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
            numbers, episodes = self._numbers(source), set(column[np.isfinite(column)].tolist())
            place = -1 if whole else self._place(source, episodes)
            rows = np.flatnonzero(column == (numbers[place] if numbers else self._sources.index(source)))
        if not len(rows) and whole:
            return np.arange(len(column))
        if not len(rows):
            raise ValueError("the table has no rows for it.")
        return rows

    def _numbers(self, source: Path) -> list[int]:
        """The numbers in the name of a video or a folder of pictures."""
        stem = source.name if source in self.folders else source.stem
        return [part[1] for part in pictures.natural(stem) if part[0] == 0]

    def _place(self, source: Path, episodes: set) -> int:
        """Which of the numbers in the names tells the sources beside this one apart and is an episode of the table.

        Raises:
            ValueError: several are, or the names count from another number than the table.
        """
        beside = [other for other in self._sources if len(self.tables) == 1 or other.parent == source.parent]
        named = [numbers for other in beside if (numbers := self._numbers(other))]
        places = [set(values) for values in zip(*named, strict=False)]
        fitting = [
            place for place, values in enumerate(places) if values & episodes and (len(values) > 1 or len(named) == 1)
        ]
        mend = "write the names of the files into the table's column."
        if len(fitting) > 1:
            found = ", ".join(map(str, self._numbers(source)))
            raise ValueError(f"several of the numbers in its name ({found}) are episodes of the table: {mend}")
        if not fitting:
            return -1
        values = places[fitting[0]]
        shifts = {mine - theirs for mine, theirs in zip(sorted(values), sorted(episodes), strict=False)}
        if len(values) == len(episodes) and len(shifts) == 1 and shifts != {0}:
            raise ValueError(f"the names count from {min(values)} and the table from {min(episodes):g}: {mend}")
        return fitting[0]
