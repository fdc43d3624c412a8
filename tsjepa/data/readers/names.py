"""Names and units of columns, as strangers write them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tsjepa.data.readers.episode import UNKNOWN

SUFFIXES = {
    "m_s2": "m/s^2",
    "rad_s": "rad/s",
    "deg_s": "deg/s",
    "m_s": "m/s",
    "mps": "m/s",
    "rad": "rad",
    "deg": "deg",
    "nm": "N m",
    "newton": "N",
    "n": "N",
    "mm": "mm",
    "m": "m",
    "volt": "V",
    "v": "V",
    "a": "A",
    "rpm": "rpm",
}
SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0, "seconds": 1.0}
TIME = re.compile(r"^_?(time|timestamp|stamp|t|datetime|elapsed)$", re.IGNORECASE)
ACTION = re.compile(r"^(action|actions|command|commands|cmd|control|u|ctrl)($|[\W_\d])", re.IGNORECASE)
STATE = re.compile(r"^(observation\.state|state|states|obs|qpos|qvel|position|velocity|x)($|[\W_\d])", re.IGNORECASE)


def split_unit(name: str) -> tuple[str, str | None]:
    """``"delay(ms)"`` or ``"delay [ms]"`` as ("delay", "ms"); ("delay", None) without brackets."""
    match = re.fullmatch(r"\s*(.*?)\s*[(\[]\s*([^)\]]*?)\s*[)\]]\s*", name)
    return (match[1], match[2] or None) if match else (name.strip(), None)


def unit_of(name: str) -> str:
    """Unit that a column's name states, in brackets or as a suffix such as ``_m_s``; "unknown" otherwise."""
    bare, unit = split_unit(name)
    if unit:
        return unit
    lower = bare.lower()
    return next((unit for suffix, unit in SUFFIXES.items() if lower.endswith("_" + suffix)), UNKNOWN)


def units_of(names: Sequence[str]) -> list[str]:
    """:func:`unit_of` of each."""
    return [unit_of(name) for name in names]


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


def flat_names(names: object, width: int, stem: str) -> list[str]:
    """Names of ``width`` columns from a (nested) list or a dict of lists; ``stem_0``, ... where they do not fit."""
    flat: list[str] = []

    def add(item: object) -> None:
        if isinstance(item, dict):
            for value in item.values():
                add(value)
        elif isinstance(item, (list, tuple)):
            for value in item:
                add(value)
        elif item is not None:
            flat.append(str(item))

    add(names)
    if len(flat) == width and len(set(flat)) == width:
        return flat
    return [f"{stem}_{column}" for column in range(width)]
