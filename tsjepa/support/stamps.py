"""Times in the files of others: which column they are, their unit, dates, and what counts since 1970."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0, "seconds": 1.0}
TIME = re.compile(
    r"^_?((elapsed|unix|epoch|relative|rel|log|header|sample|frame|capture)[._ ]?)?"
    r"(time|times|time_?stamp|time_?stamps|stamp|ts|t|date_?time|elapsed|epoch)$",
    re.IGNORECASE,
)
ZONE = re.compile(r"(\d{4}[-/]\d\d[-/]\d\d[T ][\d:.]+)\s*(?:Z|UTC|([+-])(\d\d):?(\d\d))?")


def time_column(table: Mapping[str, np.ndarray], wanted: str | None = None) -> tuple[str, np.ndarray] | None:
    """Name and seconds of the column of times; None where there is none.

    Raises:
        ValueError: the wanted one is missing or holds no numbers.
    """
    if wanted is not None:
        if wanted not in table:
            raise ValueError(f"there is no column {wanted}; there are {', '.join(table)}.")
        return wanted, as_seconds(table[wanted], time_scale(wanted) or 1.0)
    for name, column in table.items():
        scale = time_scale(name)
        if scale is not None and column.ndim == 1:
            try:
                return name, as_seconds(column, scale)
            except ValueError:
                continue
    return None


def as_seconds(stamps: np.ndarray, scale: float) -> np.ndarray:
    """Seconds; the scale of stamps since 1970 is told by their size, whatever the column is called; dates are read."""
    if stamps.dtype == object:
        stamps = dates(stamps)
    typical = np.nanmedian(np.abs(stamps)) if np.isfinite(stamps.astype(float)).any() else 0
    scale = since_1970(float(typical)) or scale
    if stamps.dtype.kind == "i" and len(stamps):
        return (stamps - stamps[0]) * scale + float(stamps[0]) * scale
    return stamps.astype(float) * scale


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


def since_1970(typical: float) -> float | None:
    """Seconds in one unit of stamps of this size, if they are milli-, micro- or nanoseconds since 1970."""
    return next((unit for least, unit in ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3)) if typical >= least), None)


def time_scale(name: str) -> float | None:
    """Seconds in one unit of a time column, from its name (``t_ms``, ``stamp(ns)``, ``time``); None: not a time.

    A name without a unit counts in seconds.
    """
    bare, unit = split_unit(name)
    if unit is None:
        head, _, tail = bare.rpartition("_")
        if head and tail.lower() in SECONDS:
            bare, unit = head, tail
    if not TIME.match(bare):
        return None
    return SECONDS.get((unit or "s").lower())


def split_unit(name: str) -> tuple[str, str | None]:
    """``"delay(ms)"`` or ``"delay [ms]"`` as ("delay", "ms"); ("delay", None) without brackets."""
    match = re.fullmatch(r"\s*(.*?)\s*[(\[]\s*([^)\]]*?)\s*[)\]]\s*", name)
    return (match[1], match[2] or None) if match else (name.strip(), None)
