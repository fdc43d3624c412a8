"""Tables of rows: CSV, Parquet and JSON lines, as columns of numbers."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tsjepa.support.foreign import optional, refuse_pointer

SUFFIXES = (".csv", ".tsv", ".parquet", ".jsonl", ".json")
MOST_ROWS = 50_000_000  # of one file; a Parquet footer may claim any number

SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0, "seconds": 1.0}
TIME = re.compile(r"^_?(time|timestamp|stamp|t|datetime|elapsed)$", re.IGNORECASE)
Table = dict[str, np.ndarray]


def read_table(path: Path, columns: Sequence[str] | None = None) -> Table:
    """Columns by name: [rows] or, where every row holds a list, [rows, width].

    Numbers come as float64 with NaN where a cell is empty or no number; columns of words come as objects.

    Raises:
        ValueError: it is no such table, or one of ``columns`` is missing.
    """
    refuse_pointer(path)
    if path.suffix == ".parquet":
        table = _read_parquet(path, columns)
    elif path.suffix in (".jsonl", ".json"):
        rows = read_json_lines(path)
        names = dict.fromkeys(name for row in rows for name in row)
        table = {name: _column([row.get(name) for row in rows]) for name in names}
    else:
        table = _read_csv(path)
    if columns is not None:
        missing = [name for name in columns if name not in table]
        if missing:
            raise ValueError(f"{path.name} has no column {', '.join(missing)}; it has {', '.join(table)}.")
        table = {name: table[name] for name in columns}
    return table


def read_json_lines(path: Path) -> list[dict]:
    """One object a line.

    Raises:
        ValueError: a line is no object; the sentence names it.
    """
    refuse_pointer(path)
    rows = []
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            if not line.strip():
                continue
            try:
                row = json.loads(line)
            except ValueError as error:
                raise ValueError(f"line {number} of {path.name} is no JSON.") from error
            if not isinstance(row, dict):
                raise ValueError(f"line {number} of {path.name} is no JSON object.")
            rows.append(row)
    return rows


def read_json(path: Path) -> dict:
    """A JSON object.

    Raises:
        ValueError: it is none.
    """
    refuse_pointer(path)
    try:
        value = json.loads(path.read_text(encoding="utf-8", errors="replace"))
    except ValueError as error:
        raise ValueError(f"{path.name} is no JSON ({error}).") from error
    if not isinstance(value, dict):
        raise ValueError(f"{path.name} is no JSON object.")
    return value


def parquet_rows(path: Path) -> int:
    """Rows that the file claims.

    Raises:
        ValueError: it is no Parquet file, or claims more rows than its bytes can hold.
    """
    refuse_pointer(path)
    pa = optional("pyarrow")
    try:
        rows = optional("pyarrow.parquet").ParquetFile(path).metadata.num_rows
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path.name} is no Parquet file that can be read ({_first_line(error)}).") from error
    if not 0 <= rows <= min(MOST_ROWS, 1000 * path.stat().st_size):
        raise ValueError(f"{path.name} claims {rows} rows in {path.stat().st_size} bytes; it is damaged.")
    return rows


def _read_parquet(path: Path, columns: Sequence[str] | None) -> Table:
    parquet_rows(path)
    pa, parquet = optional("pyarrow"), optional("pyarrow.parquet")
    try:
        with parquet.ParquetFile(path) as file:
            names = file.schema_arrow.names
            missing = [name for name in columns or () if name not in names]
            if missing:
                raise ValueError(f"{path.name} has no column {', '.join(missing)}; it has {', '.join(names)}.")
            table = file.read(columns=list(columns) if columns is not None else None)
            return {name: _arrow_column(pa, table[name]) for name in table.column_names}
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path.name} cannot be read ({_first_line(error)}).") from error


def _arrow_column(pa: Any, column: Any) -> np.ndarray:
    kind = column.type
    if pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        return _column(column.to_pylist())
    if pa.types.is_timestamp(kind):
        column = column.cast(pa.timestamp("ns")).cast(pa.int64())
        return column.to_numpy() * 1e-9
    if pa.types.is_integer(kind) and not column.null_count:
        return column.to_numpy()
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
        return column.cast(pa.float64()).to_numpy(zero_copy_only=False)
    return _column(column.to_pylist())


def _read_csv(path: Path) -> Table:
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        sample = file.read(65536)
        file.seek(0)
        first = sample.split("\n", 1)[0]
        delimiter = max(",;\t", key=first.count)
        rows = csv.reader(file, delimiter=delimiter)
        names = [name.strip() for name in next(rows, [])]
        if not names or not any(names):
            raise ValueError(f"{path.name} is empty.")
        if len(set(names)) < len(names):
            raise ValueError(f"{path.name} has two columns of the same name.")
        cells = [row for row in rows if any(cell.strip() for cell in row)]
    for number, row in enumerate(cells, 2):
        if len(row) < len(names) or any(cell.strip() for cell in row[len(names) :]):
            raise ValueError(f"{path.name} names {len(names)} columns and line {number} has {len(row)} cells.")
    return {name: _column([row[place].strip() or None for row in cells]) for place, name in enumerate(names)}


def _column(cells: list) -> np.ndarray:
    """float64 [rows] or [rows, width] where the cells are numbers; an array of objects where they are words."""
    if any(isinstance(cell, (list, tuple)) for cell in cells):
        widths = {len(cell) for cell in cells if isinstance(cell, (list, tuple))}
        if len(widths) != 1:
            raise ValueError(f"a column holds lists of {min(widths)} to {max(widths)} numbers.")
        empty = [None] * widths.pop()
        flat = [value for cell in cells for value in (cell if isinstance(cell, (list, tuple)) else empty)]
        return _column(flat).reshape(len(cells), -1) if flat else np.zeros((len(cells), 0))
    try:
        if all(isinstance(cell, int) and not isinstance(cell, bool) for cell in cells) and cells:
            return np.array(cells, dtype=np.int64)  # nanoseconds since 1970 do not fit a double
        return np.array([np.nan if cell is None else float(cell) for cell in cells])
    except (TypeError, ValueError, OverflowError):
        pass
    numbers = [_number(cell) for cell in cells]
    words = sum(number is None and cell is not None for number, cell in zip(numbers, cells, strict=True))
    if words <= len(cells) // 2:
        return np.array([np.nan if number is None else number for number in numbers])
    return np.array(cells, dtype=object)


def _number(cell: Any) -> float | None:
    try:
        return float(cell)
    except (TypeError, ValueError, OverflowError):
        return None


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")


def time_column(table: Table, wanted: str | None = None) -> tuple[str, np.ndarray] | None:
    """Name and seconds of the column of times; None where there is none.

    Raises:
        ValueError: the wanted one is missing or holds no numbers.
    """
    if wanted is not None:
        if wanted not in table:
            raise ValueError(f"there is no column {wanted}; there are {', '.join(table)}.")
        return wanted, as_seconds(table[wanted], time_scale(wanted) or 1.0)
    for name, column in table.items():
        scale = time_scale(name)
        if scale is not None and column.ndim == 1:
            try:
                return name, as_seconds(column, scale)
            except ValueError:
                continue
    return None


def as_seconds(stamps: np.ndarray, scale: float) -> np.ndarray:
    """Seconds; the scale of stamps since 1970 is told by their size, whatever the column is called; dates are read."""
    if stamps.dtype == object:
        try:
            stamps = np.array([str(stamp).replace(" ", "T").rstrip("Z") for stamp in stamps], dtype="datetime64[ns]")
        except ValueError as error:
            raise ValueError("a column of times holds words instead of numbers or dates.") from error
        stamps = stamps.astype(np.int64)
    typical = np.nanmedian(np.abs(stamps)) if np.isfinite(stamps.astype(float)).any() else 0
    for least, of_epoch in ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3)):
        if typical >= least:
            scale = of_epoch
            break
    if stamps.dtype.kind == "i" and len(stamps):
        return (stamps - stamps[0]) * scale + float(stamps[0]) * scale
    return stamps.astype(float) * scale


def time_scale(name: str) -> float | None:
    """Seconds in one unit of a time column, from its name (``t_ms``, ``stamp(ns)``, ``time``); None: not a time.

    A name without a unit counts in seconds.
    """
    bare, unit = split_unit(name)
    if unit is None:
        head, _, tail = bare.rpartition("_")
        if head and tail.lower() in SECONDS:
            bare, unit = head, tail
    if not TIME.match(bare):
        return None
    return SECONDS.get((unit or "s").lower())


def split_unit(name: str) -> tuple[str, str | None]:
    """``"delay(ms)"`` or ``"delay [ms]"`` as ("delay", "ms"); ("delay", None) without brackets."""
    match = re.fullmatch(r"\s*(.*?)\s*[(\[]\s*([^)\]]*?)\s*[)\]]\s*", name)
    return (match[1], match[2] or None) if match else (name.strip(), None)
