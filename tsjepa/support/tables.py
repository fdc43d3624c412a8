"""Tables of rows: CSV, Parquet and JSON, as columns of numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tsjepa.support.delimited import NUMBER, as_columns, decimal_points, kind, read_text, split_rows
from tsjepa.support.foreign import optional, refuse_pointer

JSON_SUFFIXES = (".jsonl", ".ndjson", ".json")
SUFFIXES = (".csv", ".tsv", ".parquet", *JSON_SUFFIXES)
MOST_ROWS = 50_000_000  # of one file; a Parquet footer may claim any number

Table = dict[str, np.ndarray]


def read_table(path: Path, columns: Sequence[str] | None = None) -> Table:
    """Columns by name: [rows] or, where every row holds a list, [rows, width].

    Numbers come as float64 with NaN where a cell is empty or no number; columns of words come as objects.

    Raises:
        ValueError: it is no such table, or one of ``columns`` is missing.
    """
    refuse_pointer(path)
    if kind(path) == ".parquet":
        table = _read_parquet(path, columns)
    elif kind(path) in JSON_SUFFIXES:
        table = {name: _column(cells) for name, cells in as_columns(read_json_rows(path)).items()}
    else:
        table = _read_csv(path)
    if columns is not None:
        missing = [name for name in columns if name not in table]
        if missing:
            raise ValueError(f"{path.name} has no column {', '.join(missing)}; it has {', '.join(table)}.")
        table = {name: table[name] for name in columns}
    return table


def read_json_rows(path: Path) -> list[dict]:
    """One object a line, a list of objects, or one object of equally long lists.

    Raises:
        ValueError: it is none of these.
    """
    refuse_pointer(path)
    try:
        whole = json.loads(read_text(path))
    except (ValueError, RecursionError):
        return read_json_lines(path)
    if isinstance(whole, list) and all(isinstance(row, dict) for row in whole):
        return whole
    if isinstance(whole, dict):
        lists = [value for value in whole.values() if isinstance(value, list)]
        if len(lists) == 1 and lists[0] and all(isinstance(row, dict) for row in lists[0]):
            return lists[0]
        if lists and len(lists) == len(whole) and len({len(value) for value in lists}) == 1:
            return [dict(zip(whole, cells, strict=True)) for cells in zip(*lists, strict=True)]
    return read_json_lines(path)


def read_json_lines(path: Path) -> list[dict]:
    """One object a line.

    Raises:
        ValueError: a line is no object; the sentence names it.
    """
    refuse_pointer(path)
    rows = []
    for number, line in enumerate(read_text(path).split("\n"), 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
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
        value = json.loads(read_text(path))
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
    text = read_text(path)
    try:
        mark, found = split_rows(text)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
    (_, header), *rows = found or [(1, [])]
    names = [name.strip() for name in header]
    while names and not names[-1]:  # a mark at the end of every line
        names.pop()
    if not names:
        raise ValueError(f"{path.name} is empty.")
    if not names[0] and "index" not in names:  # as pandas writes its index
        names[0] = "index"
    if any(NUMBER.fullmatch(name) and "." in name for name in names):
        raise ValueError(f"the first line of {path.name} holds numbers instead of names; put the names above it.")
    if len(set(names)) < len(names):
        raise ValueError(f"{path.name} has two columns of the same name.")
    for number, row in rows:
        if len(row) < len(names) or any(cell.strip() for cell in row[len(names) :]):
            raise ValueError(f"{path.name} names {len(names)} columns and line {number} has {len(row)} cells.")
    return {
        name: _column(decimal_points([row[place].strip() or None for _, row in rows], mark))
        for place, name in enumerate(names)
    }


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
