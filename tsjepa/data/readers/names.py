"""Names and units of columns, as strangers write them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from tsjepa.support.spec import UNKNOWN
from tsjepa.support.stamps import split_unit
from tsjepa.support.tables import Table

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
ACTION = re.compile(r"^(action|actions|command|commands|cmd|control|u|ctrl)($|[\W_\d])", re.IGNORECASE)
STATE = re.compile(r"^(observation\.state|state|states|obs|qpos|qvel|position|velocity|x)($|[\W_\d])", re.IGNORECASE)


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


def flat_names(names: object, width: int, stem: str) -> list[str]:
    """Names of ``width`` columns from a (nested) list, a dict of lists or of places; else ``stem_0``, ..."""
    flat: list[str] = []

    def add(item: object) -> None:
        if isinstance(item, dict) and item and all(type(value) is int for value in item.values()):
            flat.extend(map(str, sorted(item, key=item.get)))  # names with their places
        elif isinstance(item, dict):
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


def columns_like(
    table: Table, wanted: Iterable[str] | None, kind: str, skip: Iterable[str] = ()
) -> tuple[list[str], np.ndarray]:
    """Names and values float32 [rows, width] of the command's or the state's columns.

    Args:
        table: the columns.
        wanted: their names, or None to take those whose names say so.
        kind: "action" or "state".
        skip: columns that are something else.

    Raises:
        ValueError: a wanted column is missing or holds words.
    """
    if wanted is None:
        pattern = ACTION if kind == "action" else STATE
        wanted = [
            name
            for name, column in table.items()
            if pattern.match(name) and name not in skip and column.dtype != object
        ]
    names, parts = [], []
    for name in wanted:
        if name not in table:
            raise ValueError(f"there is no column {name}; there are {', '.join(table)}.")
        if table[name].dtype == object:
            raise ValueError(f"the column {name} holds words instead of numbers.")
        column = table[name].astype(np.float32)
        column = column[:, None] if column.ndim == 1 else column
        names += [name] if column.shape[1] == 1 else [f"{name}_{place}" for place in range(column.shape[1])]
        parts.append(column)
    rows = len(next(iter(table.values()))) if table else 0
    return names, np.concatenate(parts, axis=1) if parts else np.zeros((rows, 0), np.float32)
