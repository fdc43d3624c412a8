"""Logs of received packets: what is missing in their numbers was lost."""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation

import numpy as np

from tsjepa.radio.trace_log import Log
from tsjepa.radio.trace_numbers import counts_of
from tsjepa.support.stamps import seconds_in, split_unit, unit_of

SEQUENCE = ("seqnum", "seq", "sequence", "seq_num", "sequence_number", "icmp_seq", "packet_id", "pkt_id")
SENT = re.compile(r"(src|sent|send|tx|departure|dep)_?(timestamp|time|stamp|ts|ns)?(_(ns|us|ms|s))?$", re.IGNORECASE)
RECEIVED = re.compile(
    r"((dst|recv|received|receive|rx|arrival|arr)_?)?(timestamp|time|stamp|ts)?(_(ns|us|ms|s))?$", re.IGNORECASE
)


def packet_log(name: str, rows: list[dict], sequence: str, notes: list[str]) -> Log:
    """Received packets with sequence numbers: a number that is absent between the first and the last was lost."""
    times = [key for key in rows[0] if key != sequence and decimal(rows[0][key]) is not None]
    sent_key = next((key for key in times if SENT.fullmatch(_bare(key))), None)
    others = (key for key in times if key != sent_key)
    received_key = next((key for key in others if RECEIVED.fullmatch(_bare(key))), None)
    if sent_key is None and received_key is None:
        raise ValueError(f"{name} has sequence numbers and no time among {', '.join(rows[0])}.")
    stamps = [nanoseconds([row.get(key) for row in rows], key) if key else [0] * len(rows)
              for key in (sent_key, received_key)]  # fmt: skip
    cells = zip([integer(row.get(sequence)) for row in rows], *stamps, strict=True)
    packets = np.array([packet for packet in cells if None not in packet], np.int64)
    if not len(packets):
        raise ValueError(f"{name} holds no packet with a number and a time.")
    if len(packets) < len(rows):
        notes.append(f"{len(rows) - len(packets)} rows have no number or time and are left out.")
    counts, starts = counts_of(packets[:, 0])
    if starts:
        notes.append(f"The sequence numbers start again {starts} times; they are counted on.")
    numbers, first = np.unique(counts, return_index=True)
    if len(first) < len(packets):
        notes.append(f"{len(packets) - len(first)} packets were received twice; the first counts.")
    span = int(numbers[-1] - numbers[0]) + 1
    if span > 1000 * len(numbers) + 1000:
        raise ValueError(f"the sequence numbers of {name} run over {span} for {len(numbers)} packets: are they such?")
    sent, received = packets[first, 1], packets[first, 2]
    clock = sent if sent_key else received
    time = (clock - clock[0]) * 1e-9
    steps = np.diff(numbers)
    period = float(np.median(np.diff(time) / steps)) if len(steps) else 1.0
    place = numbers - numbers[0]
    lost = np.ones(span)
    lost[place] = 0
    columns = {"lost": lost}
    if sent_key and received_key:
        delay = (received - sent) * 1e-6
        notes += without_offset(delay, period)
        columns["delay_ms"] = np.full(span, np.nan)
        columns["delay_ms"][place] = delay
    on_grid = np.interp(np.arange(span), place, time)
    return Log("packet log", on_grid - on_grid[0], columns, period, notes)


def _bare(key: str) -> str:
    """The last part of a nested name, without its unit in brackets."""
    return split_unit(key.rpartition(".")[2])[0]


def nanoseconds(cells: list, name: str) -> list[int | None]:
    """Stamps as whole nanoseconds, by the unit that their name tells, or else their size; None where there is none."""
    values = [decimal(cell) for cell in cells]
    known = sorted(abs(value) for value in values if value is not None)
    if not known:
        return [None] * len(cells)
    bare, unit = split_unit(name)
    scale = unit_of(float(known[len(known) // 2]), seconds_in(unit or bare.rpartition("_")[2]) or 1.0)
    ticks = Decimal(round(scale * 1e9))
    stamps = [None if value is None else int(value * ticks) for value in values]
    return [stamp if stamp is not None and abs(stamp) < 2**62 else None for stamp in stamps]


def without_offset(delay: np.ndarray, period: float = np.inf) -> list[str]:
    """Takes the offset of two clocks out of one-way delays (ms), in place; says what it did.

    A smallest delay that moves by more than a tenth of ``period`` seconds is said, too.
    """
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


def integer(value: object) -> int | None:
    """A whole number, which some logs write as words."""
    number = decimal(value)
    return int(number) if number is not None and number == int(number) and abs(number) < 2**62 else None


def decimal(value: object) -> Decimal | None:
    """A number with all its digits: stamps in nanoseconds do not fit a double."""
    if isinstance(value, bool) or value is None:
        return None
    try:
        number = Decimal(str(value).strip())
    except InvalidOperation:
        return None
    return number if number.is_finite() and abs(number) < Decimal(10) ** 30 else None
