"""Which rows of a table belong to picture files: by the names that rows give, by numbers, by times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tsjepa.data.readers.pictures import SUFFIXES
from tsjepa.support.stamps import as_seconds
from tsjepa.support.tables import Table

NUMBER = ("frame", "frame_index", "frame_id", "frame_number", "image_index", "image_id", "picture")
STAMP = re.compile(r"\d{10,19}|\d{10}\.\d+")
EARLIEST_S = 1e9  # since 1970: September 2001; a smaller number of ten digits is a count with zeros before it


def picture_columns(table: Table) -> list[str]:
    """Columns whose cells name picture files; each is a camera."""
    return [
        name
        for name, column in table.items()
        if column.dtype == object
        and len(column)
        and all(Path(file_name(cell)).suffix.lower() in SUFFIXES for cell in column)
    ]


def file_name(cell: object) -> str:
    """The last part of a path, as Windows or anybody else writes it."""
    return re.split(r"[\\/]", str(cell).strip())[-1]


def number_of(file: Path) -> int | None:
    """The last number in a file's name."""
    found = re.findall(r"\d+", file.stem)
    return int(found[-1]) if found else None


def rows_of_pictures(files: Sequence[Path], table: Table) -> np.ndarray | None:
    """The row of every picture, where some rows have none and the pictures' numbers tell which; else None.

    Args:
        files: in their order.
        table: the rows, perhaps with a column of the pictures' numbers.
    """
    rows = len(next(iter(table.values())))
    numbers = [number_of(file) for file in files]
    if None in numbers or len(set(numbers)) < len(numbers):
        return None
    own = next((table[name] for name in NUMBER if name in table and table[name].dtype.kind in "if"), None)
    if own is None:
        if len(files) >= rows or numbers[-1] - numbers[0] + 1 != rows:
            return None
        return np.array(numbers) - numbers[0]
    place = {int(number): row for row, number in enumerate(own) if np.isfinite(number)}
    if len(place) < rows or not set(numbers) <= set(place):
        return None
    found = np.array([place[number] for number in numbers])
    return None if len(files) == rows and (found == np.arange(rows)).all() else found


def times_in_names(files: Sequence[Path]) -> np.ndarray | None:
    """Seconds since 1970 that the pictures are called by, or None."""
    labels = [file.stem for file in files]
    if not all(STAMP.fullmatch(label) and float(label) >= EARLIEST_S for label in labels):
        return None
    if any("." in label for label in labels):
        return np.array([float(label) for label in labels])
    return as_seconds(np.array([int(label) for label in labels]), 1.0)
