"""Logs of radio links that are tables with named columns."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from tsjepa.radio.trace_log import Log, ordered
from tsjepa.radio.trace_packets import without_offset
from tsjepa.support.delimited import decimal_points, delimiter_of, without_comments
from tsjepa.support.stamps import as_seconds, seconds_in, split_unit
from tsjepa.support.tables import Table

NOTES, EXTRA = "\0notes", "\0extra fields"  # of a table, beside its columns
DEVICE = re.compile(r"(device|ue|node|client|station|sta|terminal|sensor|robot)([_ ]?(id|name|index))?|imsi|rnti|mac",
                    re.IGNORECASE)  # fmt: skip
MOST_DEVICES = 1000
COLUMNS = {
    "time_s": (
        r"((pub|send|sent|tx|src|elapsed|unix|epoch)_?)?(time|date_?time|timestamp|stamp|ts|t)(_?stamp)?|elapsed|epoch"
    ),
    "delay_ms": r"delay|rtt|latency|one_way_delay|owd|ping",
    "rsrp_dbm": r"rsrp|rssi|signal",
    "sinr_db": r"sinr|snr",
    "lost": r"lost|loss|dropped",
}
SHARES = {"%": 0.01, "percent": 0.01, "pct": 0.01}
WORDS = {"true": "1", "yes": "1", "lost": "1", "false": "0", "no": "0", "ok": "0", "received": "0"}  # of a loss
NUMBER = re.compile(r"[-+]?[\d.,]+(e[-+]?\d+)?", re.IGNORECASE)
DASH = {"-", "--", "—", "*", "n/a", "N/A"}


def text_table(path: Path, lines: list[str]) -> Table:
    """Words separated by commas, semicolons, tabs or blanks; extra fields without a name are left out and named."""
    lines = without_comments(lines)
    mark = delimiter_of(lines[0])
    separated = mark in lines[0]
    try:
        cells = csv.reader(lines, delimiter=mark) if separated else map(str.split, lines)
        header, *rows = ([cell.strip().strip('"') for cell in row] for row in cells)
    except csv.Error as error:
        raise ValueError(f"{path.name} is no log of a radio link that is known: {error}.") from error
    width = len(header)
    while width and not header[width - 1]:  # a mark at the end of every line
        width -= 1
    places = {name: place for place, name in enumerate(header) if name}
    if len(places) < 2 or not rows or len(places) < sum(map(bool, header)):
        raise ValueError(f"{path.name} is no log of a radio link that is known: its first line names no columns.")
    if _is_units(rows[0], rows[1:2]):
        units = dict(enumerate(rows.pop(0)))
        places = {f"{name} ({units[place]})" if units.get(place) else name: place for name, place in places.items()}
    full = sum(len(row) >= width for row in rows)
    numbers = sum(any(NUMBER.fullmatch(cell) for cell in row) for row in rows)
    if (not separated and full < 0.9 * len(rows)) or not numbers:
        raise ValueError(f"{path.name} is no log of a radio link that is known: its lines are no rows of a table.")
    columns = {name: [row[place] if place < len(row) else "" for row in rows] for name, place in places.items()}
    table: Table = {name: np.array(_pointed(cells, mark), dtype=object) for name, cells in columns.items()}
    if extra := max(len([cell for cell in row[width:] if cell]) for row in rows):
        table[EXTRA] = np.array([float(extra)])
    return table


def _pointed(cells: list[str], mark: str) -> list[str]:
    """The cells with decimal points, whatever stands for a loss."""
    pointed = decimal_points([None if cell in DASH else cell for cell in cells], mark)
    return [cell if point is None else point for cell, point in zip(cells, pointed, strict=True)]


def _is_units(row: list[str], next_rows: list[list[str]]) -> bool:
    """Whether the line below the names holds their units: words where the next line holds numbers."""
    words = [cell.strip("[]()") for cell in row if cell]
    units = [seconds_in(word) or word.lower() in ("db", "dbm", *SHARES) for word in words]
    return any(units) and not any(NUMBER.fullmatch(word) for word in words) and any(
        NUMBER.fullmatch(cell) for following in next_rows for cell in following
    )  # fmt: skip


def by_device(table: Table) -> dict[str, Table]:
    """The rows of each device by "NAME=DEVICE", where a column tells devices apart; else all of them by ""."""
    rows = {name: column for name, column in table.items() if name not in (NOTES, EXTRA)}
    for name, column in rows.items():
        labels = np.array([str(cell) for cell in column])
        devices = list(dict.fromkeys(labels))
        if DEVICE.fullmatch(name.rpartition(".")[2]) and 1 < len(devices) <= min(MOST_DEVICES, len(labels) // 2):
            parts = {device: labels == device for device in devices}
            return {
                f"{name}={device}": {key: column[part] if key in rows else column for key, column in table.items()}
                for device, part in parts.items()
            }
    return {"": table}


def table_log(table: Table, wanted: dict[str, str], name: str) -> Log:
    """The log of a table of one link.

    Raises:
        ValueError: a column or a unit is not known, or it holds no number.
    """
    table = dict(table)
    notes = [str(note) for note in table.pop(NOTES, ())]
    if EXTRA in table:
        extra = int(table.pop(EXTRA)[0])
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
    if "lost" in chosen and table[chosen["lost"]].dtype == object:
        words = [str(cell).strip() for cell in table[chosen["lost"]]]
        table[chosen["lost"]] = np.array([WORDS.get(word.lower(), word) for word in words], dtype=object)
    values = {column: _cells(table[own], own, notes) for column, own in chosen.items()}
    unit = name_and_unit(chosen["time_s"])[1] or "s"
    stamps = values["time_s"][0]
    if not np.isfinite(stamps.astype(float)).any() and len(stamps):
        stamps = table[chosen["time_s"]]  # dates
    elif seconds_in(unit) is None:
        raise ValueError(f"the unit {unit} of {chosen['time_s']} in {name} is not known; known are ns, us, ms and s.")
    try:
        time = as_seconds(stamps, seconds_in(unit) or 1.0)
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
            numbers, gone = _milliseconds(numbers, own, notes)
            dashes = dashes | gone
            if dashes.any() and "lost" not in chosen:
                columns["lost"] = dashes.astype(float)[good]
                notes.append(f"{int(dashes.sum())} delays are {'below zero' if gone.any() else 'a dash'}: "
                             "they count as lost.")  # fmt: skip
        if column == "lost":
            numbers = _share(numbers, own)
        if column == "rsrp_dbm" and (numbers == 0).any():
            notes.append(f"{int((numbers == 0).sum())} values of {own} are 0 dBm, which no receiver sees: not logged.")
            numbers = np.where(numbers == 0, np.nan, numbers)
        columns[column] = numbers[good]
    if not any(np.isfinite(column).any() for column in columns.values()):
        raise ValueError(f"the columns {', '.join(own for own in chosen.values())} of {name} hold no number.")
    return ordered("table", time[good], columns, notes)


def name_and_unit(column: str) -> tuple[str, str | None]:
    """``"delay (us)"``, ``"delay_us"`` and ``"link.delay_us"`` as ("delay", "us")."""
    bare, unit = split_unit(column.rpartition(".")[2])
    head, _, tail = bare.rpartition("_")
    known = seconds_in(tail) or tail.lower() in ("db", "dbm", *SHARES)
    return (head, tail) if unit is None and head and known else (bare, unit)


def _milliseconds(delay: np.ndarray, own: str, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Delays in ms, and where they are one number below zero that stands for a loss.

    Raises:
        ValueError: their unit is not known.
    """
    unit = name_and_unit(own)[1]
    scale = seconds_in(unit) if unit else 1e-3
    if scale is None:
        raise ValueError(f"the unit {unit} of {own} is not known; known are ns, us, ms and s.")
    if unit is None:
        notes.append(f"{own} names no unit: it is taken for milliseconds.")
    delay = np.array(delay, dtype=float) * (1000 * scale)
    gone = delay < 0
    if gone.any() and len(np.unique(delay[gone])) > 1:
        known = np.isfinite(delay)
        rest = delay[known]
        notes += without_offset(rest)
        delay[known] = rest
        return delay, np.zeros(len(delay), bool)
    delay[gone] = np.nan
    return delay, gone


def _share(lost: np.ndarray, own: str) -> np.ndarray:
    """Losses as 1, 0 or a share.

    Raises:
        ValueError: they are counts.
    """
    lost = lost * SHARES.get((name_and_unit(own)[1] or "").lower(), 1.0)
    if (lost > 1).any() or (lost < 0).any():
        raise ValueError(
            f"the column {own} runs to {np.nanmax(lost):g}; a loss is 0, 1, a share, or has % in its name."
        )
    return lost


def _cells(cells: np.ndarray, name: str, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (NaN where there is none) and where a dash stands; missing, zero and dash are counted apart."""
    if cells.dtype != object:
        return cells, np.zeros(len(cells), bool)
    words = [str(cell).strip() if cell is not None else "" for cell in cells]
    dashes = np.array([word in DASH for word in words])
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
