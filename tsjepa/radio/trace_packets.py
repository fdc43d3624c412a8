"""Logs of received packets: what is missing in their numbers was lost."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from tsjepa.radio.trace_log import Log
from tsjepa.support.tables import as_seconds

SEQUENCE = ("seqnum", "seq", "sequence", "seq_num", "sequence_number", "icmp_seq", "packet_id", "pkt_id")
SENT = re.compile(r"(src|sent|send|tx)_?(timestamp|time|stamp|ts|ns)?(_(ns|us|ms|s))?$", re.IGNORECASE)
RECEIVED = re.compile(r"((dst|recv|received|receive|rx)_?)?(timestamp|time|stamp|ts)?(_(ns|us|ms|s))?$", re.IGNORECASE)


def packet_log(name: str, rows: list[dict], sequence: str, notes: list[str]) -> Log:
    """Received packets with sequence numbers: a number that is absent between the first and the last was lost."""
    times = [key for key in rows[0] if key != sequence and integer(rows[0][key]) is not None]
    sent_key = next((key for key in times if SENT.fullmatch(key.rpartition(".")[2])), None)
    others = (key for key in times if key != sent_key)
    received_key = next((key for key in others if RECEIVED.fullmatch(key.rpartition(".")[2])), None)
    if sent_key is None and received_key is None:
        raise ValueError(f"{name} has sequence numbers and no time among {', '.join(rows[0])}.")
    numbers: list[int] = []
    sent: list[int] = []
    received: list[int] = []
    for row in rows:
        values: list[Any] = [integer(row.get(key)) if key else 0 for key in (sequence, sent_key, received_key)]
        if None not in values:
            for column, value in zip((numbers, sent, received), values, strict=True):
                column.append(value)
    if not numbers:
        raise ValueError(f"{name} holds no packet with a number and a time.")
    if len(numbers) < len(rows):
        notes.append(f"{len(rows) - len(numbers)} rows have no number or time and are left out.")
    unique, first = np.unique(np.array(numbers, np.int64), return_index=True)
    if len(first) < len(sent):
        notes.append(f"{len(sent) - len(first)} packets were received twice; the first counts.")
    span = int(unique[-1] - unique[0]) + 1
    if span > 1000 * len(unique) + 1000:
        raise ValueError(f"the sequence numbers of {name} run over {span} for {len(unique)} packets: are they such?")
    clocks = [as_seconds(np.array(times, np.int64)[first], 1.0) for times in (sent, received)]
    time = clocks[0] if sent_key else clocks[1]
    steps = np.diff(unique)
    period = float(np.median(np.diff(time) / steps)) if len(steps) else 1.0
    place = unique - unique[0]
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


def integer(value: Any) -> int | None:
    """Stamps in nanoseconds do not fit a double, and some logs write them as words."""
    try:
        return int(value)
    except (TypeError, ValueError, OverflowError):
        return None
