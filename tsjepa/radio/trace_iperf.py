"""What iperf writes: text of versions 2 and 3, JSON of version 3."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tsjepa.radio.trace_log import Log

IPERF = re.compile(r"\[\s*(SUM|\d+)\](?:\[[^\]]*\])?\s+([\d.]+)-\s*([\d.]+)\s+sec(.*)")
LOST = re.compile(r"(\d+)/\s*(\d+)\s+\(")
SUMMARY = re.compile(r"(sender|receiver|\(omitted\))\s*$")
NO_LOSS = (
    "{} is an iperf log that tells neither what was lost nor a delay: log the receiver of a UDP test (iperf3 -s), or a "
    "TCP test as JSON (iperf3 -J)."
)


def iperf_text_log(name: str, lines: list[str]) -> Log:
    """Intervals of the receiver of a UDP test; several streams are one, by their sum.

    Raises:
        ValueError: no interval says what was lost.
    """
    streams: dict[str, dict[tuple[float, float], tuple[float, float]]] = {}
    for line in lines:
        row = IPERF.search(line)
        if row is None or SUMMARY.search(line):
            continue
        if share := LOST.search(row[4]):
            interval = (float(row[2]), float(row[3]))
            streams.setdefault(row[1], {}).setdefault(interval, (float(share[1]), float(share[2])))
    if not streams:
        raise ValueError(NO_LOSS.format(name))
    chosen = {"SUM": streams["SUM"]} if "SUM" in streams else streams
    total: dict[tuple[float, float], np.ndarray] = {}
    for rows in chosen.values():
        for interval, counts in rows.items():
            total[interval] = total.get(interval, 0) + np.array(counts)
    log = iperf_log([(*interval, *counts) for interval, counts in sorted(total.items())])
    if len(streams.keys() - {"SUM"}) > 1:
        log.notes.append(f"{len(streams.keys() - {'SUM'})} streams are counted as one.")
    return log


def iperf_log(intervals: list[tuple[float, float, float, float]]) -> Log:
    """Intervals of (start, end, lost, sent); those that sum up others are left out."""
    lengths = [end - start for start, end, *_ in intervals]
    intervals = [row for row, length in zip(intervals, lengths, strict=True) if length <= 1.5 * np.median(lengths)]
    table = np.array(intervals)
    share = np.divide(table[:, 2], table[:, 3], out=np.full(len(table), np.nan), where=table[:, 3] > 0)
    period = float(np.median(table[:, 1] - table[:, 0]))
    notes = ["iperf gives the share that was lost in an interval, not which packets, and no delay."]
    return Log("iperf3", table[:, 0] - table[0, 0], {"lost": share}, period, notes)


def iperf_json_log(path: Path, whole: Mapping) -> Log:
    """The intervals of ``iperf3 -J``: losses of a UDP test's receiver, or the round-trip times of a TCP test.

    Raises:
        ValueError: no interval has either.
    """
    for part in (whole, whole.get("server_output_json")):
        intervals = part.get("intervals") if isinstance(part, Mapping) else None
        intervals = [entry for entry in intervals if isinstance(entry, dict)] if isinstance(intervals, list) else []
        sums = [entry.get("sum") for entry in intervals if isinstance(entry.get("sum"), dict)]
        sums = [entry for entry in sums if entry.get("omitted") is not True]
        rows = [tuple(entry[key] for key in ("start", "end", "lost_packets", "packets")) for entry in sums
                if {"start", "end", "lost_packets", "packets"} <= set(entry)]  # fmt: skip
        if rows:
            return iperf_log(rows)
        streams = [entry.get("streams") for entry in intervals]
        firsts = [parts[0] for parts in streams if isinstance(parts, list) and parts and isinstance(parts[0], dict)]
        trips = [
            (entry["start"], entry["end"], entry["rtt"])
            for entry in firsts
            if {"start", "end", "rtt"} <= set(entry) and entry.get("omitted") is not True
        ]
        if trips:
            table = np.array(trips, dtype=float)
            notes = ["The delays are round-trip times of TCP, smoothed by its sender; what was lost was sent again."]
            period = float(np.median(table[:, 1] - table[:, 0]))
            return Log("iperf3", table[:, 0] - table[0, 0], {"delay_ms": table[:, 2] / 1000}, period, notes)
    raise ValueError(NO_LOSS.format(path.name))
