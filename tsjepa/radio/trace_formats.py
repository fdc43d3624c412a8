"""Tells how a log of a radio link is written, and reads it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from tsjepa.radio.trace_log import Log
from tsjepa.radio.trace_packets import RECEIVED, SEQUENCE, integer, packet_log
from tsjepa.radio.trace_tables import table_log, text_table
from tsjepa.radio.trace_texts import (
    IPERF,
    PING,
    SIGNAL,
    iperf_json_log,
    iperf_log,
    opportunity_log,
    ping_log,
    signal_log,
)
from tsjepa.support.foreign import refuse_pointer
from tsjepa.support.tables import as_seconds, read_table

MOST_BYTES = 2 << 30  # of one log; they are read whole


def read_log(path: Path, columns: dict[str, str], period_s: float | None = None) -> Log:
    """Reads one log, whatever its kind.

    Args:
        path: text or Parquet.
        columns: our column to the log's, where its names do not say it.
        period_s: seconds between rows, for logs without times; the step in which delivery opportunities are read.

    Raises:
        ValueError: it is no log of a radio link that is known, or holds no row.
    """
    refuse_pointer(path)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path.name} has {path.stat().st_size / 1e9:.1f} GB; cut it into smaller logs.")
    if path.suffix == ".parquet":
        return table_log(read_table(path), columns, path.name)
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines:
        raise ValueError(f"{path.name} is empty.")
    if text.lstrip().startswith("{"):
        return json_log(path, text, lines, columns)
    if any(PING.search(line) for line in lines[:50]):
        return ping_log(lines, period_s or 1.0)
    if any(IPERF.search(line) for line in lines):
        return iperf_log([tuple(map(float, match.groups())) for line in lines if (match := IPERF.search(line))])
    if SIGNAL.search(text) and "SSID" in text:
        blocks = [block for block in re.split(r"(?=Connected to|Not connected|Station )", text) if block.strip()]
        if period_s is None and len(blocks) > 1:
            raise ValueError(f"{path.name} is `iw` text without times: say how far apart its blocks are (--period_s).")
        return signal_log(np.arange(len(blocks)) * (period_s or 1.0), blocks)
    if all(line.strip().isdigit() for line in lines):
        return opportunity_log(np.array([int(line) for line in lines]), period_s or 0.02)
    return table_log(text_table(path, lines), columns, path.name)


def json_log(path: Path, text: str, lines: list[str], columns: dict[str, str]) -> Log:
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
        except ValueError as error:
            try:
                whole = json.loads(text)
            except ValueError:
                raise ValueError(f"line {number} of {path.name} is no JSON.") from error
            return iperf_json_log(path, whole)
        if not isinstance(row, dict):
            raise ValueError(f"line {number} of {path.name} is no JSON object.")
        rows.append(dict(_flat(row)))
    if len(rows) == 1 and "intervals" in json.loads(lines[0]):
        return iperf_json_log(path, json.loads(lines[0]))
    notes = _labels(path.stem, rows)
    texts = [key for key, value in rows[0].items() if isinstance(value, str) and SIGNAL.search(value)]
    if texts:
        stamps = [
            key for key in rows[0] if RECEIVED.match(key.rpartition(".")[2]) and integer(rows[0][key]) is not None
        ]
        if not stamps:
            raise ValueError(f"{path.name} is `iw` text without a time.")
        time = as_seconds(np.array([integer(row.get(stamps[0])) or 0 for row in rows]), 1.0)
        log = signal_log(time, [str(row.get(texts[0])) for row in rows])
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
    log = table_log(cells, columns, path.name)
    log.notes += notes
    return log


def _flat(row: dict, prefix: str = ""):
    for key, value in row.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _labels(stem: str, rows: list[dict]) -> list[str]:
    """Labels such as run1 that contradict the file's name."""
    in_name, notes = dict(re.findall(r"([a-zA-Z]+?)_?(\d+)(?=_|$)", stem)), []
    for value in {value for row in rows[:1] + rows[-1:] for value in row.values() if isinstance(value, str)}:
        match = re.fullmatch(r"([a-zA-Z]+)(\d+)", value)
        if match and in_name.get(match[1], match[2]) != match[2]:
            notes.append(f"The file's name says {match[1]}{in_name[match[1]]}, its rows say {value}.")
    return notes
