"""Times in the files of others: which column they are, their unit, dates, and what counts since 1970."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

SECONDS = {
    **dict.fromkeys(("ns", "nsec", "nanoseconds"), 1e-9),
    **dict.fromkeys(("us", "usec", "microseconds"), 1e-6),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("min", "minutes"), 60.0),
}
DAY_S = 86400.0
LATEST_S = 1e11  # since 1970: the year 5138
SLOW_S = 1.0  # a recording of longer steps is rare, a column of milliseconds that is called time is not
CLOCK = re.compile(r"(\d\d?):(\d\d):(\d\d(?:[.,]\d+)?)")
LEADING = re.compile(
    r"\s*\[?(?P<epoch>\d{9,10}(?:\.\d+)?|\d{13}|\d{16}|\d{19})\]?(?=\s|$)"
    r"|\s*\[?(?P<date>\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?)\]?"
    r"|\s*\[?(?P<clock>\d\d:\d\d:\d\d(?:\.\d+)?)\]?(?=\s|$)"
)
TIME = re.compile(
    r"^_?((elapsed|unix|epoch|relative|rel|log|header|sample|frame|capture)[._ ]?)?"
    r"(time|times|time_?stamp|time_?stamps|stamp|ts|t|date_?time|elapsed|epoch)$",
    re.IGNORECASE,
)
ZONE = re.compile(r"(\d{4}[-/]\d\d[-/]\d\d[T ][\d:.]+)\s*(?:Z|UTC|([+-])(\d\d):?(\d\d))?")


def time_column(table: Mapping[str, np.ndarray], wanted: str | None = None) -> tuple[str, np.ndarray] | None:
    """Name and seconds of the column of times; None where there is none.

    Args:
        table: columns by name.
        wanted: see :func:`wanted_times`; else the first whose name says that it is one.

    Raises:
        ValueError: the wanted one is missing or holds no numbers.
    """
    if wanted is not None:
        name, scale = wanted_times(wanted, table)
        return name, as_seconds(table[name], scale or 1.0)
    for name, column in table.items():
        scale = time_scale(name)
        if scale is not None and column.ndim == 1:
            try:
                return name, as_seconds(column, scale)
            except ValueError:
                continue
    return None


def wanted_times(wanted: str, names: Iterable[str]) -> tuple[str, float | None]:
    """The one of ``names`` that is wanted, as it is called or with its unit behind it (``time(ms)`` for ``time``), and
    the seconds in one unit, None where neither states it.

    Raises:
        ValueError: there is none of that name.
    """
    names = list(names)
    bare, unit = split_unit(wanted)
    name = bare if wanted not in names and unit is not None and seconds_in(unit) is not None else wanted
    if name not in names:
        raise ValueError(f"there is no column {wanted}; there are {', '.join(names)}.")
    return name, stated_scale(wanted)


def slow_note(name: str, stamps: np.ndarray) -> list[str]:
    """One sentence for numbers that are taken for seconds because ``name`` states no unit, where they rise so fast that
    they may be milliseconds or less."""
    if stamps.dtype == object or stated_scale(name) is not None:
        return []
    steps = np.diff(stamps.astype(float))
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    if step <= SLOW_S or unit_of(float(np.nanmedian(np.abs(stamps.astype(float)))), 1.0) != 1.0:
        return []
    unit = next((unit for most, unit in ((1e3, "ms"), (1e6, "us")) if step < most), "ns")
    return [
        f"its column {name} states no unit and is taken for seconds, a row every {step:.4g} s; if it counts {unit}, "
        f"call it {name}_{unit}, or pass --time '{name}({unit})'."
    ]


def as_seconds(stamps: np.ndarray, scale: float) -> np.ndarray:
    """Seconds [N] of stamps [N] that are numbers, dates or times of day.

    Args:
        stamps: numbers, or an array of objects that are words.
        scale: seconds in one unit of the numbers, as their column names it, or 1; see :func:`unit_of`.

    Raises:
        ValueError: a word is neither a date nor a time of day.
    """
    if stamps.dtype == object:
        clocks = [CLOCK.fullmatch(str(word).strip()) for word in stamps]
        known = [match for match in clocks if match]
        if known and len(known) == len(clocks):
            return clock_seconds([_clock(match) for match in known])
        stamps, scale = dates(stamps), 1e-9
    typical = np.nanmedian(np.abs(stamps)) if np.isfinite(stamps.astype(float)).any() else 0
    scale = unit_of(float(typical), scale)
    if stamps.dtype.kind == "i" and len(stamps):
        return (stamps - stamps[0]) * scale + float(stamps[0]) * scale
    return stamps.astype(float) * scale


def clock_seconds(seconds: list[float]) -> np.ndarray:
    """Times of day as a time that goes on after midnight."""
    times = np.array(seconds)
    days = np.concatenate([[0], np.cumsum(np.diff(times) < -DAY_S / 2)]) if len(times) else np.zeros(0)
    return times + DAY_S * days


def _clock(match: re.Match) -> float:
    return 3600 * int(match[1]) + 60 * int(match[2]) + float(match[3].replace(",", "."))


def leading_time(line: str, alone: bool = False) -> float | None:
    """Seconds at which a line of a log begins: since 1970, a date, or a time of day; None where it does not.

    Args:
        line: such as "[1700000000.5] 64 bytes from ...".
        alone: nothing may stand behind it.
    """
    match = LEADING.match(line)
    if match is None or (alone and line[match.end() :].strip()):
        return None
    if match["epoch"]:
        value = float(match["epoch"])
        return value * unit_of(value, 1.0)
    if match["date"]:
        return float(dates(np.array([match["date"].replace(",", ".")], dtype=object))[0]) * 1e-9
    clock = CLOCK.match(match["clock"])
    return _clock(clock) if clock else None


def dates(words: np.ndarray) -> np.ndarray:
    """Nanoseconds since 1970 (int64) of dates as ISO 8601 writes them, with or without a time zone.

    Raises:
        ValueError: one of them is no date.
    """
    try:
        found = [_date(str(word)) for word in words]
        bare = [match[1].replace(" ", "T").replace("/", "-") for match in found]
        stamps = np.array(bare, dtype="datetime64[ns]").astype(np.int64)
    except ValueError as error:
        raise ValueError("a column of times holds words instead of numbers or dates.") from error
    minutes = [0 if match[2] is None else int(match[2] + match[3]) * 60 + int(match[2] + match[4]) for match in found]
    return stamps - np.array(minutes, np.int64) * 60 * 10**9


def _date(word: str) -> re.Match[str]:
    match = ZONE.fullmatch(word.strip())
    if match is None:
        raise ValueError(f"{word} is no date.")
    return match


def unit_of(typical: float, scale: float) -> float:
    """Seconds in one unit of stamps of the size ``typical``.

    A unit that would put them after the year 5000 is not theirs: they are milli-, micro- or nanoseconds since 1970, and
    their size tells which.

    Args:
        typical: the absolute value of a stamp.
        scale: seconds in the unit that their column names; 1 where it names none.
    """
    if typical * scale < LATEST_S:
        return scale
    return next((unit for least, unit in ((1e17, 1e-9), (1e14, 1e-6), (LATEST_S, 1e-3)) if typical >= least), scale)


def time_scale(name: str) -> float | None:
    """Seconds in one unit of a time column, from its name (``t_ms``, ``stamp(ns)``, ``time``); None: not a time.

    A name without a unit counts in seconds.
    """
    bare, unit = _with_unit(name)
    return seconds_in(unit or "s") if TIME.match(bare) else None


def stated_scale(name: str) -> float | None:
    """Seconds in the unit that a column's name states, whatever it is called; None where it states no unit of time."""
    unit = _with_unit(name)[1]
    return None if unit is None else seconds_in(unit)


def _with_unit(name: str) -> tuple[str, str | None]:
    """A name and its unit in brackets or behind a line, ``time_ms``; None where it has none."""
    bare, unit = split_unit(name)
    head, _, tail = bare.rpartition("_")
    return (head, tail) if unit is None and head and seconds_in(tail) else (bare, unit)


def seconds_in(unit: str) -> float | None:
    """Seconds in one ``unit``, such as "ms", "µs" or "sec"; None where it is no unit of time."""
    return SECONDS.get(unit.strip().rstrip(".").lower().replace("µ", "u").replace("μ", "u"))


def split_unit(name: str) -> tuple[str, str | None]:
    """``"delay(ms)"`` or ``"delay [ms]"`` as ("delay", "ms"); ("delay", None) without brackets."""
    match = re.fullmatch(r"\s*(.*?)\s*[(\[]\s*([^)\]]*?)\s*[)\]]\s*", name)
    return (match[1], match[2] or None) if match else (name.strip(), None)
