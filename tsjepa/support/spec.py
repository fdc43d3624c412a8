"""The sizes, names and units of one kind of machine; a plant states them, a data set and a model carry them along."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

UNKNOWN = "unknown"


@dataclass(frozen=True)
class PlantSpec:
    """What differs between machines, as plain values.

    Args:
        action_low, action_high: range of the m commands that the actuator takes, in ``action_units``.
        slot: seconds between two frames, and for which a command is held.
        frame: height and width of a picture in pixels.
        state_names, state_units: of the n numbers of the state; empty where nobody measures it.
        state_scale: by what each state is of order one; integer codecs of the state cover plus and minus this.
        action_names, action_units: of the m commands.
        reference_names, reference_units: of the r set-points that the controller is given beside the embedding.
        reference_low, reference_high: their range.
        watched: the state whose error says when a prediction is lost, or None.
        watched_limit: that error, in its unit.

    Raises:
        ValueError: ranges that are empty or not finite, or lists of different lengths.
    """

    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    slot: float
    frame: tuple[int, int]
    state_names: tuple[str, ...] = ()
    state_units: tuple[str, ...] = ()
    state_scale: tuple[float, ...] = ()
    action_names: tuple[str, ...] = ()
    action_units: tuple[str, ...] = ()
    reference_names: tuple[str, ...] = ()
    reference_units: tuple[str, ...] = ()
    reference_low: tuple[float, ...] = ()
    reference_high: tuple[float, ...] = ()
    watched: str | None = None
    watched_limit: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            if isinstance(value := getattr(self, field.name), list):
                object.__setattr__(self, field.name, tuple(value))
        for low, high in (("action_low", "action_high"), ("reference_low", "reference_high")):
            pairs = list(zip(getattr(self, low), getattr(self, high), strict=False))
            if len(getattr(self, low)) != len(getattr(self, high)) or not all(
                -math.inf < a < b < math.inf for a, b in pairs
            ):
                raise ValueError(
                    f"{low} {list(getattr(self, low))} and {high} {list(getattr(self, high))} must be finite, as many "
                    "as each other, and leave a range between them."
                )
        if not (math.isfinite(self.slot) and self.slot > 0):
            raise ValueError(f"slot must be a positive number of seconds, got {self.slot!r}.")
        for name, count in (("state", self.state_dim), ("action", self.action_dim), ("reference", self.reference_dim)):
            for part in ("names", "units", "scale"):
                values = getattr(self, f"{name}_{part}", ())
                if values and len(values) != count:
                    raise ValueError(f"{name}_{part} has {len(values)} entries for {count} numbers: {list(values)}.")

    @property
    def state_dim(self) -> int:
        """n."""
        return len(self.state_names)

    @property
    def action_dim(self) -> int:
        """m."""
        return len(self.action_low)

    @property
    def reference_dim(self) -> int:
        """r."""
        return len(self.reference_low)

    @property
    def action_range(self) -> tuple[float, ...]:
        """max(u) - min(u) of the actuator, by which command errors are divided."""
        return tuple(high - low for low, high in zip(self.action_low, self.action_high, strict=True))

    @property
    def rest(self) -> tuple[float, ...]:
        """The command nearest to zero."""
        ranges = zip(self.action_low, self.action_high, strict=True)
        return tuple(float(min(max(0.0, low), high)) for low, high in ranges)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists and numbers, for JSON and YAML."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> PlantSpec:
        """The spec that :meth:`to_dict` wrote.

        Raises:
            ValueError: names that this version does not know, or none for the command's range.
        """
        known = {field.name for field in fields(cls)}
        if unknown := set(values) - known:
            raise ValueError(f"The spec names {', '.join(sorted(unknown))}, which this version does not know.")
        if lacking := {"action_low", "action_high", "slot", "frame"} - set(values):
            raise ValueError(f"The spec lacks {', '.join(sorted(lacking))}.")
        return cls(**values)
