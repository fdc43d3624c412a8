"""What ping writes on Linux, BSD and macOS, in BusyBox and on Windows."""

from __future__ import annotations

import re

import numpy as np

from tsjepa.radio.trace_log import Log
from tsjepa.radio.trace_numbers import count_of
from tsjepa.support.stamps import leading_time

NUMBER = re.compile(r"(?:icmp_)?(?:seq|req)[= ]\s*(\d+)")
PING = re.compile(NUMBER.pattern + r".*?[=<]\s*([\d.,]+) ?ms")
SENT = re.compile(r"(\d+) packets? transmitted")
HEADER = re.compile(r"^PING6?\b")
FROM_ZERO = re.compile(r"Request timeout|hlim=|(?<!icmp_)seq=")  # BSD and BusyBox count from 0, Linux from 1
REPLY = re.compile(r"^\s*\S.*?:\s+(?:\S+=\d+\s+)?\S+[=<](\d+)\s?ms(?:\s+TTL=\d+)?\s*$", re.IGNORECASE)
HEAD = re.compile(r"\d.*:\s*$")
ROUND_TRIPS = "The delays are round trips."


def ping_log(lines: list[str], period: float) -> Log:
    """Answers with their round-trip times; numbers without an answer are lost, those up to the summary's count too."""
    answers: dict[int, float] = {}
    stamps: dict[int, float] = {}
    lost: set[int] = set()
    twice = base = 0
    first = 0 if any(FROM_ZERO.search(line) for line in lines) else 1
    last, runs = None, 1  # the newest count of this run
    for line in lines:
        if HEADER.match(line) and last is not None:
            base, last, runs = max((*answers, *lost)) + 1 - first, None, runs + 1
        elif match := NUMBER.search(line):
            last = count_of(int(match[1]), last or 0)
            number = base + last
            if answer := PING.search(line):
                twice += number in answers
                answers.setdefault(number, float(answer[2].replace(",", ".")))
                if (stamp := leading_time(line)) is not None:
                    stamps.setdefault(number, stamp - answers[number] / 1000)
            else:
                lost.add(number)
        elif (match := SENT.search(line)) and int(match[1]) <= 1000 * len(lines):
            end = base + first + int(match[1])
            if end > max((-1, *answers, *lost)):
                lost.update(range(base + first, end))
    numbers = sorted({*answers, *lost})
    if numbers[-1] - numbers[0] > 1000 * len(numbers) + 1000:
        raise ValueError(f"the numbers of the pings run from {numbers[0]} to {numbers[-1]} for {len(numbers)} lines.")
    span = np.arange(numbers[0], numbers[-1] + 1)
    delay = np.array([answers.get(int(number), np.nan) for number in span])
    notes = [f"{twice} answers came twice; the first counts."] if twice else []
    notes += [f"{runs} runs of ping are joined; the pauses between them are not known."] if runs > 1 else []
    if len(stamps) > 1:
        known = np.array(sorted(stamps))
        steps = np.diff([stamps[int(number)] for number in known]) / np.diff(known)
        period = float(np.median(steps))
        time: np.ndarray = np.interp(span, known, [stamps[int(number)] for number in known])
        time += period * (np.minimum(span - known[0], 0) + np.maximum(span - known[-1], 0))
    else:
        time = span * period
        notes.append(f"The log has no times: {period:g} s from one ping to the next are taken.")
    columns = {"delay_ms": delay, "lost": np.isnan(delay).astype(float)}
    return Log("ping", time - time[0], columns, period, [*notes, ROUND_TRIPS])


def reply_log(lines: list[str], period: float) -> Log:
    """What ping prints on Windows, in any language: answers without numbers, in their order.

    Between the header and the statistics, both of which have a number and end in a colon, a line that is no answer and
    not indented is a lost request.
    """
    delay: list[float] = []
    headed = any(HEAD.search(line) for line in lines[:3])
    inside, runs = not headed, 0
    for line in lines:
        if HEAD.search(line):
            inside = headed and not inside
            runs += inside
        elif line.rstrip().endswith(":"):
            inside = False
        elif match := REPLY.match(line):
            delay.append(float(match[1]))
        elif inside and not line[:1].isspace():
            delay.append(np.nan)
    values = np.array(delay)
    columns = {"delay_ms": values, "lost": np.isnan(values).astype(float)}
    notes = [f"The log has no times: {period:g} s from one ping to the next are taken.", ROUND_TRIPS]
    notes += [f"{runs} runs of ping are joined; the pauses between them are not known."] if runs > 1 else []
    return Log("ping", period * np.arange(len(values)), columns, period, notes)
