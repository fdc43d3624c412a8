"""Logs of radio links that are tables with named columns."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tsjepa.radio.trace_log import Log, ordered
from tsjepa.support.delimited import decimal_points, delimiter_of, without_comments
from tsjepa.support.stamps import SECONDS, as_seconds, split_unit
from tsjepa.support.tables import Table

MILLISECONDS = {unit: 1000 * seconds for unit, seconds in SECONDS.items()}
COLUMNS = {
    "time_s": (
        r"((pub|send|sent|tx|src|elapsed|unix|epoch)_?)?(time|date_?time|timestamp|stamp|ts|t)(_?stamp)?|elapsed|epoch"
    ),
    "delay_ms": r"delay|rtt|latency|one_way_delay|owd|ping",
    "rsrp_dbm": r"rsrp|rssi|signal",
    "sinr_db": r"sinr|snr",
    "lost": r"lost|loss|dropped",
}
UNITS = {*SECONDS, "db", "dbm"}
DASH = {"-", "--", "—", "*", "n/a", "N/A"}


def text_table(path: Path, lines: list[str]) -> Table:
    """Words separated by commas, semicolons, tabs or blanks; extra fields without a name are left out and named."""
    lines = without_comments(lines)
    delimiter: str | None = delimiter_of(lines[0])
    if delimiter is not None and delimiter not in lines[0]:
        delimiter = None
    names = [name.strip().strip('"') for name in lines[0].split(delimiter) if name.strip()]
    if len(names) < 2 or len(lines) < 2 or len(set(names)) < len(names):
        raise ValueError(f"{path.name} is no log of a radio link that is known: its first line names no columns.")
    rows = [[cell.strip().strip('"') for cell in line.rstrip("\r\n").split(delimiter)] for line in lines[1:]]
    full = sum(len(row) >= len(names) for row in rows)
    numbers = sum(any(re.fullmatch(r"[-+]?[\d.,]+(e[-+]?\d+)?", cell) for cell in row) for row in rows)
    if (delimiter is None and full < 0.9 * len(rows)) or not numbers:
        raise ValueError(f"{path.name} is no log of a radio link that is known: its lines are no rows of a table.")
    widths = {len([cell for cell in row[len(names) :] if cell]) for row in rows}
    table: Table = {name: np.array([row[place] if place < len(row) else "" for row in rows], dtype=object)
                    for place, name in enumerate(names)}  # fmt: skip
    if extra := max(widths):
        table["extra fields"] = np.array([float(extra)])
    return table


def table_log(table: Table, wanted: dict[str, str], name: str) -> Log:
    notes = []
    if "extra fields" in table:
        extra = int(table.pop("extra fields")[0])
        notes.append(
            f"{name} names {len(table)} columns and has rows of {len(table) + extra} fields; the last {extra} have no "
            "name and are left out."
        )
    chosen = {}
    for column, pattern in COLUMNS.items():
        if column in wanted and wanted[column] not in table:
            raise ValueError(f"{name} has no column {wanted[column]}; it has {', '.join(table)}.")
        match = wanted.get(column) or next(
            (own for own in table if re.fullmatch(pattern, name_and_unit(own)[0], re.IGNORECASE)), None
        )
        if match is not None:
            chosen[column] = match
    if "time_s" not in chosen:
        raise ValueError(f"no column of {name} is a time among {', '.join(table)}: say --column time_s=NAME.")
    if len(chosen) == 1:
        raise ValueError(
            f"no column of {name} is a delay, a signal or a loss among {', '.join(table)}: say --column delay_ms=NAME."
        )
    values = {column: _cells(table[own], own, notes) for column, own in chosen.items()}
    unit = name_and_unit(chosen["time_s"])[1] or "s"
    stamps = values["time_s"][0]
    if not np.isfinite(stamps.astype(float)).any() and len(stamps):
        stamps = table[chosen["time_s"]]  # dates
    try:
        time = as_seconds(stamps, SECONDS.get(unit.lower(), 1.0))
    except ValueError as error:
        raise ValueError(f"{name} holds no row with a time.") from error
    good = np.isfinite(time)
    if not good.any():
        raise ValueError(f"{name} holds no row with a time.")
    if not good.all():
        notes.append(f"{int((~good).sum())} rows have no time and are left out.")
    columns = {}
    for column, own in chosen.items():
        if column == "time_s":
            continue
        numbers, dashes = values[column]
        if column == "delay_ms":
            numbers = numbers * MILLISECONDS.get((name_and_unit(own)[1] or "ms").lower(), 1.0)
            if dashes.any() and "lost" not in chosen:
                columns["lost"] = dashes.astype(float)[good]
                notes.append(f"{int(dashes.sum())} delays are a dash: they count as lost.")
        if column == "rsrp_dbm" and (numbers == 0).any():
            notes.append(f"{int((numbers == 0).sum())} values of {own} are 0 dBm, which no receiver sees: not logged.")
            numbers = np.where(numbers == 0, np.nan, numbers)
        columns[column] = numbers[good]
    if not any(np.isfinite(column).any() for column in columns.values()):
        raise ValueError(f"the columns {', '.join(own for own in chosen.values())} of {name} hold no number.")
    return ordered("table", time[good], columns, notes)


def name_and_unit(column: str) -> tuple[str, str | None]:
    """``"delay (us)"`` and ``"delay_us"`` as ("delay", "us")."""
    bare, unit = split_unit(column)
    head, _, tail = bare.rpartition("_")
    return (head, tail) if unit is None and head and tail.lower() in UNITS else (bare, unit)


def _cells(cells: np.ndarray, name: str, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (NaN where there is none) and where a dash stands; missing, zero and dash are counted apart."""
    if cells.dtype != object:
        return cells, np.zeros(len(cells), bool)
    words = [str(cell).strip() if cell is not None else "" for cell in cells]
    dashes = np.array([word in DASH for word in words])
    if dashes.sum() < len(words):
        pointed = decimal_points([None if dash else word for word, dash in zip(words, dashes, strict=True)])
        words = ["-" if word is None else word for word in pointed]
    if all(word.lstrip("-").isdigit() for word in words):
        return np.array([int(word) for word in words]), dashes
    numbers = np.full(len(words), np.nan)
    for place, word in enumerate(words):
        try:
            numbers[place] = float(word)
        except ValueError:
            continue
    missing, zero = int(np.isnan(numbers).sum() - dashes.sum()), int((numbers == 0).sum())
    if missing or dashes.any():
        notes.append(f"{name}: {missing} missing, {int(dashes.sum())} dashes, {zero} zeros of {len(words)}.")
    return numbers, dashes
