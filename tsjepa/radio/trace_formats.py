"""Tells how a log of a radio link is written, and reads it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from tsjepa.radio.trace_iperf import IPERF, iperf_json_log, iperf_text_log
from tsjepa.radio.trace_log import Log
from tsjepa.radio.trace_packets import RECEIVED, SEQUENCE, integer, nanoseconds, packet_log
from tsjepa.radio.trace_pings import PING, REPLY, ping_log, reply_log
from tsjepa.radio.trace_tables import COLUMNS, NOTES, by_device, table_log, text_table
from tsjepa.radio.trace_texts import POLL, SIGNAL, iw_log, opportunity_log, signal_log
from tsjepa.support.delimited import flat, kind, read_text
from tsjepa.support.foreign import refuse_pointer
from tsjepa.support.stamps import split_unit
from tsjepa.support.tables import Table, read_json_rows, read_table

MOST_BYTES = 2 << 30  # of one log; they are read whole


def read_links(path: Path, columns: dict[str, str], period_s: float | None = None) -> dict[str, Log]:
    """The links of one log: one by "", or where a table has a column of devices, one a device, by "NAME=DEVICE".

    Args:
        path: text or Parquet.
        columns: our column to the log's, where its names do not say it.
        period_s: seconds between rows, for logs without times; the step in which delivery opportunities are read.

    Raises:
        ValueError: it is no log of a radio link that is known, or holds no row.
    """
    found = _parse(path, columns, period_s)
    if isinstance(found, Log):
        return {"": found}
    return {name: table_log(table, columns, path.name) for name, table in by_device(found).items()}


def _parse(path: Path, columns: dict[str, str], period_s: float | None) -> Log | Table:
    refuse_pointer(path)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path.name} has {path.stat().st_size / 1e9:.1f} GB; cut it into smaller logs.")
    if kind(path) == ".parquet":
        return read_table(path)
    text = read_text(path)
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines:
        raise ValueError(f"{path.name} is empty.")
    if re.match(r"\s*(\{|\[\s*\{)", text):  # ping and iperf3 begin with [, too
        return json_log(path, text, lines, columns)
    if any(PING.search(line) for line in lines):
        return ping_log(lines, period_s or 1.0)
    if any(REPLY.match(line) for line in lines):
        return reply_log(lines, period_s or 1.0)
    if any(IPERF.search(line) for line in lines):
        return iperf_text_log(path.name, lines)
    if SIGNAL.search(text) and any(POLL.match(line.strip()) for line in lines):
        return iw_log(path.name, lines, period_s)
    if all(line.strip().isdigit() for line in lines):
        return opportunity_log(np.array([int(line) for line in lines]), period_s or 0.02)
    table = text_table(path, lines)
    return (packet_table(path.name, table) if not columns else None) or table


def packet_table(name: str, table: Table) -> Log | None:
    """The log of a table with sequence numbers and times and nothing else that tells of the link, or None."""
    sequence = next((own for own in table if own.lower() in SEQUENCE), None)
    known = [pattern for column, pattern in COLUMNS.items() if column != "time_s"]
    if sequence is None or any(re.fullmatch("|".join(known), split_unit(own)[0], re.IGNORECASE) for own in table):
        return None
    cells = {own: column for own, column in table.items() if own != "extra fields"}
    rows = [dict(zip(cells, row, strict=True)) for row in zip(*cells.values(), strict=True)]
    return packet_log(name, rows, sequence, [])


def json_log(path: Path, text: str, lines: list[str], columns: dict[str, str]) -> Log | Table:
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except ValueError as error:
            try:
                whole = json.loads(text)
            except ValueError:
                raise ValueError(f"line {number} of {path.name} is no JSON.") from error
            if isinstance(whole, dict) and "intervals" in whole:
                return iperf_json_log(path, whole)
            return rows_log(path, read_json_rows(path), columns)
        if isinstance(row, list) and len(lines) == 1:
            return rows_log(path, read_json_rows(path), columns)
        if not isinstance(row, dict):
            raise ValueError(f"line {number} of {path.name} is no JSON object.")
        rows.append(row)
    if len(rows) == 1 and "intervals" in rows[0]:
        return iperf_json_log(path, rows[0])
    if all("event" in row for row in rows) and any(row["event"] == "interval" for row in rows):  # of --json-stream
        return iperf_json_log(path, {"intervals": [row.get("data") for row in rows if row["event"] == "interval"]})
    return rows_log(path, rows, columns)


def rows_log(path: Path, rows: list[dict], columns: dict[str, str]) -> Log | Table:
    """The log of JSON objects, one a row, or their table."""
    rows = [dict(flat(row)) for row in rows]
    if not rows:
        raise ValueError(f"{path.name} holds no row.")
    notes = _labels(path.stem, rows)
    texts = [key for key, value in rows[0].items() if isinstance(value, str) and SIGNAL.search(value)]
    if texts:
        stamps = [
            key for key in rows[0] if RECEIVED.match(key.rpartition(".")[2]) and integer(rows[0][key]) is not None
        ]
        if not stamps:
            raise ValueError(f"{path.name} is `iw` text without a time.")
        time = [stamp or 0 for stamp in nanoseconds([row.get(stamps[0]) for row in rows], stamps[0])]
        log = signal_log(np.array(time) * 1e-9, [str(row.get(texts[0])) for row in rows])
        log.notes += notes
        return log
    keys = {key.rpartition(".")[2].lower(): key for key in rows[0]}
    sequence = next((keys[name] for name in SEQUENCE if name in keys), None)
    if sequence is not None:
        return packet_log(path.name, rows, sequence, notes)
    names = dict.fromkeys(key for row in rows for key in row)
    cells = {}
    for name in names:
        cells[name] = np.empty(len(rows), dtype=object)
        cells[name][:] = [row.get(name) for row in rows]
    return {**cells, NOTES: np.array(notes, dtype=object)}


def _labels(stem: str, rows: list[dict]) -> list[str]:
    """Labels such as run1 that contradict the file's name."""
    in_name, notes = dict(re.findall(r"([a-zA-Z]+?)_?(\d+)(?=_|$)", stem)), []
    for value in {value for row in rows[:1] + rows[-1:] for value in row.values() if isinstance(value, str)}:
        match = re.fullmatch(r"([a-zA-Z]+)(\d+)", value)
        if match and in_name.get(match[1], match[2]) != match[2]:
            notes.append(f"The file's name says {match[1]}{in_name[match[1]]}, its rows say {value}.")
    return notes
