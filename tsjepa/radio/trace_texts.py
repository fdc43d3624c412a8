"""What ping, iperf3, iw and mahimahi write."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tsjepa.radio.trace_log import Log, ordered

PING = re.compile(r"icmp_seq[= ](\d+).*?time[=<]([\d.]+) ?ms")
PING_LOST = re.compile(r"(?:no answer yet for|timeout for|Unreachable.*|unreachable.*|from .*) icmp_seq[= ](\d+)")
REPLY = re.compile(
    r"^\s*\S+ \S+ [\w.:]+: \S+=\d+ \S+[=<](\d+) ?ms TTL=\d+", re.IGNORECASE
)  # of Windows, without numbers
REPLY_LOST = re.compile(r"^\s*(Request timed out|.*: Destination .* unreachable|General failure)", re.IGNORECASE)
STAMP = re.compile(r"^\[(\d+\.\d+)\]")
SIGNAL = re.compile(r"signal(?: avg)?:\s*(-?\d+)")
IPERF = re.compile(r"([\d.]+)-([\d.]+)\s+sec.*?(\d+)/\s*(\d+)\s+\(")


def ping_log(lines: list[str], period: float) -> Log:
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
        time: np.ndarray = np.interp(span, known, [stamps[int(number)] for number in known])
        period = float(np.median(np.diff(time)))
    else:
        time = span * period
        notes.append(f"The log has no times: {period:g} s from one ping to the next are taken.")
    columns = {"delay_ms": delay, "lost": np.isnan(delay).astype(float)}
    return Log("ping", time - time[0], columns, period, [*notes, "The delays are round trips."])


def reply_log(lines: list[str], period: float) -> Log:
    """What ping prints on Windows: answers without numbers, in their order; a request that timed out is lost."""
    answers = []
    for line in lines:
        if match := REPLY.search(line):
            answers.append(float(match[1]))
        elif REPLY_LOST.search(line):
            answers.append(np.nan)
    delay = np.array(answers)
    columns = {"delay_ms": delay, "lost": np.isnan(delay).astype(float)}
    notes = [f"The log has no times: {period:g} s from one ping to the next are taken.", "The delays are round trips."]
    return Log("ping", period * np.arange(len(delay)), columns, period, notes)


def iperf_log(intervals: list[tuple[float, float, float, float]]) -> Log:
    """Intervals of (start, end, lost, sent); the last line, which sums them up, is left out."""
    if len(intervals) > 1 and intervals[-1][1] - intervals[-1][0] > 1.5 * (intervals[0][1] - intervals[0][0]):
        intervals = intervals[:-1]
    table = np.array(intervals)
    share = np.divide(table[:, 2], table[:, 3], out=np.full(len(table), np.nan), where=table[:, 3] > 0)
    period = float(np.median(table[:, 1] - table[:, 0]))
    notes = ["iperf3 gives the share that was lost in an interval, not which packets, and no delay."]
    return Log("iperf3", table[:, 0] - table[0, 0], {"lost": share}, period, notes)


def iperf_json_log(path: Path, whole: object) -> Log:
    intervals = whole.get("intervals") if isinstance(whole, dict) else None
    sums = [entry.get("sum") for entry in intervals if isinstance(entry, dict)] if isinstance(intervals, list) else []
    rows = [(entry["start"], entry["end"], entry["lost_packets"], entry["packets"]) for entry in sums
            if isinstance(entry, dict) and {"start", "end", "lost_packets", "packets"} <= set(entry)]  # fmt: skip
    if not rows:
        raise ValueError(f"{path.name} is no log of a radio link that is known: no interval says how many were lost.")
    return iperf_log([*rows, (0.0, 0.0, 0.0, 0.0)][: len(rows)])


def signal_log(time: np.ndarray, texts: list[str]) -> Log:
    """Received signal strength of ``iw dev ... link`` or ``station dump``."""
    matches = [SIGNAL.search(text) for text in texts]
    signal = np.array([float(match[1]) if match else np.nan for match in matches])
    notes = ["The received signal strength of Wi-Fi stands in the column rsrp_dbm."]
    if np.isnan(signal).any():
        notes.append(f"{int(np.isnan(signal).sum())} of {len(signal)} polls found no connection.")
    return ordered("iw", time, {"rsrp_dbm": signal}, notes)


def opportunity_log(milliseconds: np.ndarray, step: float) -> Log:
    """mahimahi's delivery opportunities (one packet of 1500 bytes each): the wait of a packet sent every ``step``."""
    if (np.diff(milliseconds) < 0).any() or milliseconds[-1] > 1e9:
        raise ValueError("its numbers do not rise like the milliseconds of delivery opportunities.")
    time = np.arange(0, milliseconds[-1] / 1000, step)
    if not len(time):
        raise ValueError("its delivery opportunities end before the first step.")
    wait = milliseconds[np.searchsorted(milliseconds, 1000 * time)] - 1000 * time
    notes = [f"{len(milliseconds)} delivery opportunities; the delay is the wait of a packet sent every {step:g} s."]
    return Log("mahimahi", time, {"delay_ms": wait.astype(float)}, step, notes)
