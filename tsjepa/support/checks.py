"""Arguments that cannot be, refused where they come in and in one sentence."""

from __future__ import annotations

import math


def at_least(least: float, **values: float) -> None:
    """Raises ValueError, naming the argument, unless every one of ``values`` is finite and at least ``least``."""
    for name, value in values.items():
        if not (math.isfinite(value) and value >= least):
            raise ValueError(f"{name} is {value}; it has to be at least {least}.")


def within(low: float, high: float, **values: float) -> None:
    """Raises ValueError, naming the argument, unless every one of ``values`` lies in [``low``, ``high``]."""
    for name, value in values.items():
        if not low <= value <= high:
            raise ValueError(f"{name} is {value}; it has to lie between {low} and {high}.")
