"""Logs of radio links as others write them, brought to rows of time, delay, loss and signal."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tsjepa.support.foreign import refuse_pointer
from tsjepa.support.tables import SECONDS, Table, as_seconds, read_table, split_unit

MOST_BYTES = 2 << 30  # of one log; they are read whole
MILLISECONDS = {unit: 1000 * seconds for unit, seconds in SECONDS.items()}
COLUMNS = {
    "time_s": r"((pub|send|sent|tx|src)_?)?(time|timestamp|stamp|ts|t)(_?stamp)?|time_s",
    "delay_ms": r"delay|rtt|latency|one_way_delay|owd|delay_ms|rtt_ms|latency_ms",
    "rsrp_dbm": r"rsrp|rssi|signal|rsrp_dbm",
    "sinr_db": r"sinr|snr|sinr_db|snr_db",
    "lost": r"lost|loss|dropped",
}
SEQUENCE = ("seqnum", "seq", "sequence", "seq_num", "sequence_number", "icmp_seq", "packet_id", "pkt_id")
SENT = re.compile(r"(src|sent|send|tx)_?(timestamp|time|stamp|ts|ns)?(_(ns|us|ms|s))?$", re.IGNORECASE)
RECEIVED = re.compile(r"((dst|recv|received|receive|rx)_?)?(timestamp|time|stamp|ts)?(_(ns|us|ms|s))?$", re.IGNORECASE)
PING = re.compile(r"icmp_seq[= ](\d+).*?time[=<]([\d.]+) ?ms")
PING_LOST = re.compile(r"(?:no answer yet for|timeout for|Unreachable.*|unreachable.*|from .*) icmp_seq[= ](\d+)")
STAMP = re.compile(r"^\[(\d+\.\d+)\]")
SIGNAL = re.compile(r"signal(?: avg)?:\s*(-?\d+)")
IPERF = re.compile(r"([\d.]+)-([\d.]+)\s+sec.*?(\d+)/\s*(\d+)\s+\(")
DASH = {"-", "--", "—", "*", "n/a", "N/A"}


@dataclass
class Log:
    """One link's rows; what the log does not tell is absent.

    Attributes:
        kind: how the log is written.
        time_s: seconds [N] since its first row.
        columns: float arrays [N] of ``delay_ms``, ``lost`` (1, 0, or a share), ``rsrp_dbm``, ``sinr_db``; NaN where it
            was not logged.
        period_s: seconds between rows as they were meant to be.
        notes: what is odd, one sentence each.
    """

    kind: str
    time_s: np.ndarray
    columns: dict[str, np.ndarray]
    period_s: float
    notes: list[str] = field(default_factory=list)


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
        return _table(read_table(path), columns, path.name)
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines:
        raise ValueError(f"{path.name} is empty.")
    if text.lstrip().startswith("{"):
        return _json(path, text, lines, columns)
    if any(PING.search(line) for line in lines[:50]):
        return _ping(lines, period_s or 1.0)
    if any(IPERF.search(line) for line in lines):
        return _iperf([tuple(map(float, match.groups())) for line in lines if (match := IPERF.search(line))])
    if SIGNAL.search(text) and "SSID" in text:
        blocks = [block for block in re.split(r"(?=Connected to|Not connected|Station )", text) if block.strip()]
        if period_s is None and len(blocks) > 1:
            raise ValueError(f"{path.name} is `iw` text without times: say how far apart its blocks are (--period_s).")
        return _signal(np.arange(len(blocks)) * (period_s or 1.0), blocks)
    if all(line.strip().isdigit() for line in lines):
        return _opportunities(np.array([int(line) for line in lines]), period_s or 0.02)
    return _table(_text_table(path, lines), columns, path.name)


def _text_table(path: Path, lines: list[str]) -> Table:
    """Words separated by commas, semicolons, tabs or blanks; extra fields without a name are left out and named."""
    delimiter = next((mark for mark in ",;\t" if lines[0].count(mark)), None)
    names = [name.strip() for name in lines[0].split(delimiter) if name.strip()]
    if len(names) < 2 or len(lines) < 2 or len(set(names)) < len(names):
        raise ValueError(f"{path.name} is no log of a radio link that is known: its first line names no columns.")
    rows = [[cell.strip() for cell in line.rstrip("\r\n").split(delimiter)] for line in lines[1:]]
    full = sum(len(row) >= len(names) for row in rows)
    numbers = sum(any(re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", cell) for cell in row) for row in rows)
    if (delimiter is None and full < 0.9 * len(rows)) or not numbers:
        raise ValueError(f"{path.name} is no log of a radio link that is known: its lines are no rows of a table.")
    widths = {len([cell for cell in row[len(names) :] if cell]) for row in rows}
    table: Table = {name: np.array([row[place] if place < len(row) else "" for row in rows], dtype=object)
                    for place, name in enumerate(names)}  # fmt: skip
    if extra := max(widths):
        table["extra fields"] = np.array([float(extra)])
    return table


def _table(table: Table, wanted: dict[str, str], name: str) -> Log:
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
            (own for own in table if re.fullmatch(pattern, split_unit(own)[0], re.IGNORECASE)), None
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
    unit = split_unit(chosen["time_s"])[1] or "s"
    time = as_seconds(values["time_s"][0], SECONDS.get(unit.lower(), 1.0))
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
            bare, unit = split_unit(own)
            unit = unit or bare.rpartition("_")[2]
            numbers = numbers * MILLISECONDS.get(unit.lower(), 1.0)
            if dashes.any() and "lost" not in chosen:
                columns["lost"] = dashes.astype(float)[good]
                notes.append(f"{int(dashes.sum())} delays are a dash: they count as lost.")
        if column == "rsrp_dbm" and (numbers == 0).any():
            notes.append(f"{int((numbers == 0).sum())} values of {own} are 0 dBm, which no receiver sees: not logged.")
            numbers = np.where(numbers == 0, np.nan, numbers)
        columns[column] = numbers[good]
    if not any(np.isfinite(column).any() for column in columns.values()):
        raise ValueError(f"the columns {', '.join(own for own in chosen.values())} of {name} hold no number.")
    return _ordered("table", time[good], columns, notes)


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


def _ordered(kind: str, time: np.ndarray, columns: dict[str, np.ndarray], notes: list[str]) -> Log:
    """Rows in the order of their times, the first at 0 s."""
    steps = np.diff(time)
    if (steps < 0).any():
        notes.append(f"{int((steps < 0).sum())} times go back; the rows are put in order.")
        order = np.argsort(time, kind="stable")
        time, columns = time[order], {name: column[order] for name, column in columns.items()}
    if (steps == 0).any():
        notes.append(f"{int((steps == 0).sum())} times repeat.")
    steps = np.diff(time)
    steps = steps[steps > 0]
    return Log(kind, time - time[0], columns, float(np.median(steps)) if len(steps) else 1.0, notes)


def _json(path: Path, text: str, lines: list[str], columns: dict[str, str]) -> Log:
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
        except ValueError as error:
            try:
                whole = json.loads(text)
            except ValueError:
                raise ValueError(f"line {number} of {path.name} is no JSON.") from error
            return _iperf_json(path, whole)
        if not isinstance(row, dict):
            raise ValueError(f"line {number} of {path.name} is no JSON object.")
        rows.append(dict(_flat(row)))
    if len(rows) == 1 and "intervals" in json.loads(lines[0]):
        return _iperf_json(path, json.loads(lines[0]))
    notes = _labels(path.stem, rows)
    texts = [key for key, value in rows[0].items() if isinstance(value, str) and SIGNAL.search(value)]
    if texts:
        stamps = [
            key for key in rows[0] if RECEIVED.match(key.rpartition(".")[2]) and _integer(rows[0][key]) is not None
        ]
        if not stamps:
            raise ValueError(f"{path.name} is `iw` text without a time.")
        time = as_seconds(np.array([_integer(row.get(stamps[0])) or 0 for row in rows]), 1.0)
        log = _signal(time, [str(row.get(texts[0])) for row in rows])
        log.notes += notes
        return log
    keys = {key.rpartition(".")[2].lower(): key for key in rows[0]}
    sequence = next((keys[name] for name in SEQUENCE if name in keys), None)
    if sequence is not None:
        return _packets(path.name, rows, sequence, notes)
    names = dict.fromkeys(key for row in rows for key in row)
    cells = {}
    for name in names:
        cells[name] = np.empty(len(rows), dtype=object)
        cells[name][:] = [row.get(name) for row in rows]
    log = _table(cells, columns, path.name)
    log.notes += notes
    return log


def _flat(row: dict, prefix: str = ""):
    for key, value in row.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _integer(value: object) -> int | None:
    """Stamps in nanoseconds do not fit a double, and some logs write them as words."""
    try:
        return int(value)
    except (TypeError, ValueError, OverflowError):
        return None


def _labels(stem: str, rows: list[dict]) -> list[str]:
    """Labels such as run1 that contradict the file's name."""
    in_name, notes = dict(re.findall(r"([a-zA-Z]+?)_?(\d+)(?=_|$)", stem)), []
    for value in {value for row in rows[:1] + rows[-1:] for value in row.values() if isinstance(value, str)}:
        match = re.fullmatch(r"([a-zA-Z]+)(\d+)", value)
        if match and in_name.get(match[1], match[2]) != match[2]:
            notes.append(f"The file's name says {match[1]}{in_name[match[1]]}, its rows say {value}.")
    return notes


def _packets(name: str, rows: list[dict], sequence: str, notes: list[str]) -> Log:
    """Received packets with sequence numbers: a number that is absent between the first and the last was lost."""
    times = [key for key in rows[0] if key != sequence and _integer(rows[0][key]) is not None]
    sent_key = next((key for key in times if SENT.fullmatch(key.rpartition(".")[2])), None)
    others = (key for key in times if key != sent_key)
    received_key = next((key for key in others if RECEIVED.fullmatch(key.rpartition(".")[2])), None)
    if sent_key is None and received_key is None:
        raise ValueError(f"{name} has sequence numbers and no time among {', '.join(rows[0])}.")
    numbers, sent, received = [], [], []
    for row in rows:
        values = [_integer(row.get(key)) if key else 0 for key in (sequence, sent_key, received_key)]
        if None not in values:
            numbers.append(values[0]), sent.append(values[1]), received.append(values[2])
    if not numbers:
        raise ValueError(f"{name} holds no packet with a number and a time.")
    if len(numbers) < len(rows):
        notes.append(f"{len(rows) - len(numbers)} rows have no number or time and are left out.")
    numbers, first = np.unique(np.array(numbers, np.int64), return_index=True)
    if len(first) < len(sent):
        notes.append(f"{len(sent) - len(first)} packets were received twice; the first counts.")
    span = int(numbers[-1] - numbers[0]) + 1
    if span > 1000 * len(numbers) + 1000:
        raise ValueError(f"the sequence numbers of {name} run over {span} for {len(numbers)} packets: are they such?")
    clocks = [as_seconds(np.array(times, np.int64)[first], 1.0) for times in (sent, received)]
    time = clocks[0] if sent_key else clocks[1]
    steps = np.diff(numbers)
    period = float(np.median(np.diff(time) / steps)) if len(steps) else 1.0
    place = numbers - numbers[0]
    lost = np.ones(span)
    lost[place] = 0
    columns = {"lost": lost}
    if sent_key and received_key:
        delay = 1000 * (
            np.array(received, np.int64)[first] - np.array(sent, np.int64)[first]
        ) * _scale(sent[0], received[0], name)  # fmt: skip
        notes += _without_offset(delay, period)
        columns["delay_ms"] = np.full(span, np.nan)
        columns["delay_ms"][place] = delay
    on_grid = np.interp(np.arange(span), place, time)
    return Log("packet log", on_grid - on_grid[0], columns, period, notes)


def _scale(sent: int, received: int, name: str) -> float:
    """Seconds in one tick of both stamps."""
    digits = len(str(abs(sent)))
    if digits != len(str(abs(received))):
        raise ValueError(f"the sent and received times of {name} are not in the same unit.")
    return {19: 1e-9, 16: 1e-6, 13: 1e-3}.get(digits, 1.0)


def _without_offset(delay: np.ndarray, period: float) -> list[str]:
    """Takes the offset of two clocks out of one-way delays (ms), in place; says what it did."""
    negative = int((delay < 0).sum())
    if not negative:
        return ["The one-way delays are taken as they are: none is negative."]
    least = float(delay.min())
    third = max(1, len(delay) // 3)
    drift = float(delay[-third:].min() - delay[:third].min())
    delay -= least
    note = (
        f"{negative} of {len(delay)} one-way delays are negative: the clocks of sender and receiver differ. The offset "
        f"of {least:.1f} ms is taken out, so that the smallest delay is zero; what all packets share is not known."
    )
    if abs(drift) > 1000 * period / 10:
        return [note, f"The smallest delay moves by {drift:.0f} ms from the first third to the last: the clocks drift."]
    return [note]


def _ping(lines: list[str], period: float) -> Log:
    """Answers with their round-trip times; numbers without an answer are lost."""
    answers: dict[int, float] = {}
    stamps: dict[int, float] = {}
    lost: set[int] = set()
    twice = 0
    for line in lines:
        if match := PING.search(line):
            number = int(match[1])
            twice += number in answers
            answers.setdefault(number, float(match[2]))
            if stamp := STAMP.match(line):
                stamps.setdefault(number, float(stamp[1]) - float(match[2]) / 1000)
        elif match := PING_LOST.search(line):
            lost.add(int(match[1]))
    numbers = sorted({*answers, *lost})
    if numbers[-1] - numbers[0] > 1000 * len(numbers) + 1000:
        raise ValueError(f"the numbers of the pings run from {numbers[0]} to {numbers[-1]} for {len(numbers)} lines.")
    span = np.arange(numbers[0], numbers[-1] + 1)
    delay = np.array([answers.get(int(number), np.nan) for number in span])
    notes = [f"{twice} answers came twice; the first counts."] if twice else []
    if len(stamps) > 1:
        known = np.array(sorted(stamps))
        time = np.interp(span, known, [stamps[int(number)] for number in known])
        period = float(np.median(np.diff(time)))
    else:
        time = span * period
        notes.append(f"The log has no times: {period:g} s from one ping to the next are taken.")
    columns = {"delay_ms": delay, "lost": np.isnan(delay).astype(float)}
    return Log("ping", time - time[0], columns, period, [*notes, "The delays are round trips."])


def _iperf(intervals: list[tuple[float, float, float, float]]) -> Log:
    """Intervals of (start, end, lost, sent); the last line, which sums them up, is left out."""
    if len(intervals) > 1 and intervals[-1][1] - intervals[-1][0] > 1.5 * (intervals[0][1] - intervals[0][0]):
        intervals = intervals[:-1]
    table = np.array(intervals)
    share = np.divide(table[:, 2], table[:, 3], out=np.full(len(table), np.nan), where=table[:, 3] > 0)
    period = float(np.median(table[:, 1] - table[:, 0]))
    notes = ["iperf3 gives the share that was lost in an interval, not which packets, and no delay."]
    return Log("iperf3", table[:, 0] - table[0, 0], {"lost": share}, period, notes)


def _iperf_json(path: Path, whole: object) -> Log:
    intervals = whole.get("intervals") if isinstance(whole, dict) else None
    sums = [entry.get("sum") for entry in intervals if isinstance(entry, dict)] if isinstance(intervals, list) else []
    rows = [(entry["start"], entry["end"], entry["lost_packets"], entry["packets"]) for entry in sums
            if isinstance(entry, dict) and {"start", "end", "lost_packets", "packets"} <= set(entry)]  # fmt: skip
    if not rows:
        raise ValueError(f"{path.name} is no log of a radio link that is known: no interval says how many were lost.")
    return _iperf([*rows, (0.0, 0.0, 0.0, 0.0)][: len(rows)])


def _signal(time: np.ndarray, texts: list[str]) -> Log:
    """Received signal strength of ``iw dev ... link`` or ``station dump``."""
    matches = [SIGNAL.search(text) for text in texts]
    signal = np.array([float(match[1]) if match else np.nan for match in matches])
    notes = ["The received signal strength of Wi-Fi stands in the column rsrp_dbm."]
    if np.isnan(signal).any():
        notes.append(f"{int(np.isnan(signal).sum())} of {len(signal)} polls found no connection.")
    return _ordered("iw", time, {"rsrp_dbm": signal}, notes)


def _opportunities(milliseconds: np.ndarray, step: float) -> Log:
    """mahimahi's delivery opportunities (one packet of 1500 bytes each): the wait of a packet sent every ``step``."""
    if (np.diff(milliseconds) < 0).any() or milliseconds[-1] > 1e9:
        raise ValueError("its numbers do not rise like the milliseconds of delivery opportunities.")
    time = np.arange(0, milliseconds[-1] / 1000, step)
    if not len(time):
        raise ValueError("its delivery opportunities end before the first step.")
    wait = milliseconds[np.searchsorted(milliseconds, 1000 * time)] - 1000 * time
    notes = [f"{len(milliseconds)} delivery opportunities; the delay is the wait of a packet sent every {step:g} s."]
    return Log("mahimahi", time, {"delay_ms": wait.astype(float)}, step, notes)
