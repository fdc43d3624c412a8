"""What iw and mahimahi write."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np

from tsjepa.radio.trace_log import Log, ordered
from tsjepa.support.stamps import leading_time

SIGNAL = re.compile(r"signal(?: avg)?:\s*(-?\d+)")
POLL = re.compile(r"Connected to|Not connected|Station\s+(\S+)")
MOST_STEPS = 5_000_000  # of delivery opportunities: their last number may claim any time


def iw_log(name: str, lines: list[str], period: float | None) -> Log:
    """Polls of ``iw dev ... link`` or ``station dump``, one after the other, with the time in a line before each.

    Raises:
        ValueError: nothing says when the polls were.
    """
    polls: list[tuple[float | None, str | None, list[str]]] = []
    stamp = None
    for line in lines:
        if match := POLL.match(line.strip()):
            polls.append((stamp, match[1], [line]))
        elif (found := leading_time(line, alone=True)) is not None:
            stamp = found
        elif polls:
            polls[-1][2].append(line)
    stations = Counter(station for _, station, _ in polls)
    most = stations.most_common(1)[0][0]
    polls = [poll for poll in polls if poll[1] == most]
    times = np.array([np.nan if time is None else time for time, _, _ in polls])
    if not np.isfinite(times).all() or (len(times) > 1 and not np.diff(times).any()):
        if period is None and len(polls) > 1:
            raise ValueError(f"{name} is `iw` text without times: say how far apart its blocks are (--period_s).")
        times = np.arange(len(polls)) * (period or 1.0)
    log = signal_log(times, ["\n".join(text) for _, _, text in polls])
    if len(stations) > 1:
        log.notes.append(f"It tells of {len(stations)} stations; {most}, which is polled most, is taken.")
    return log


def signal_log(time: np.ndarray, texts: list[str]) -> Log:
    """Received signal strength of polls at ``time`` seconds."""
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
    if milliseconds[-1] / 1000 / step > MOST_STEPS:
        raise ValueError(
            f"its delivery opportunities reach to {milliseconds[-1] / 1000:.0f} s: say a longer step than {step:g} s "
            "(--period_s)."
        )
    # rounded, or a packet sent at an opportunity, or at the last one, would miss it by the last bit of a double
    sent = np.round(1000 * step * np.arange(int(milliseconds[-1] / 1000 / step) + 1), 6)
    sent = sent[sent < milliseconds[-1]]
    if not len(sent):
        raise ValueError("its delivery opportunities end before the first step.")
    wait = milliseconds[np.searchsorted(milliseconds, sent)] - sent
    notes = [f"{len(milliseconds)} delivery opportunities; the delay is the wait of a packet sent every {step:g} s."]
    return Log("mahimahi", sent / 1000, {"delay_ms": wait.astype(float)}, step, notes)
