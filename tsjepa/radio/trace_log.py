"""One radio link's log in rows, whatever it was written as."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Log:
    """One link's rows; what the log does not tell is absent.

    Attributes:
        kind: how the log is written.
        time_s: seconds [N] since its first row.
        columns: float arrays [N] of ``delay_ms``, ``lost`` (1, 0, or a share), ``rsrp_dbm``, ``sinr_db``; NaN where it
            was not logged.
        period_s: seconds between rows as they were meant to be.
        notes: what is odd, one sentence each.
    """

    kind: str
    time_s: np.ndarray
    columns: dict[str, np.ndarray]
    period_s: float
    notes: list[str] = field(default_factory=list)


def ordered(kind: str, time: np.ndarray, columns: dict[str, np.ndarray], notes: list[str]) -> Log:
    """Rows in the order of their times, the first at 0 s."""
    steps = np.diff(time)
    if (steps < 0).any():
        notes.append(f"{int((steps < 0).sum())} times go back; the rows are put in order.")
        order = np.argsort(time, kind="stable")
        time, columns = time[order], {name: column[order] for name, column in columns.items()}
    if (steps == 0).any():
        notes.append(f"{int((steps == 0).sum())} times repeat.")
    steps = np.diff(time)
    steps = steps[steps > 0]
    return Log(kind, time - time[0], columns, float(np.median(steps)) if len(steps) else 1.0, notes)
