"""Sweeps written short: fields that are lists stand for all their combinations."""

from __future__ import annotations

from itertools import product


def grid(fields: dict) -> list[dict]:
    """All combinations of the fields that are lists, the last varying fastest; the others stay as they are."""
    names = [name for name, value in fields.items() if isinstance(value, list)]
    return [fields | dict(zip(names, values, strict=True)) for values in product(*(fields[name] for name in names))]
