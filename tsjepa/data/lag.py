"""How long a motion takes to follow its command."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

Lag = tuple[int, int, int]  # median, and the range from 10 to 90 %, over the columns

SAME = 0.7  # correlation from which on a state counts as the answer to a command
EXPLAINED = 0.5  # share of a state's changes that a command has to explain
MOVING = 0.5  # correlation of a command's changes with motion in the pictures, which says less
FEWEST_ROWS = 30  # a correlation over fewer says nothing
CHANCE = 0.01  # that a correlation is below its lower confidence limit
AGREEING = 0.5  # share of the moving columns, or of the rows of a recording, that has to show a lag
LONGEST_LAG_S, LONGEST_MOTION_LAG_S = 1.5, 0.5


def command_lag(action: np.ndarray, response: np.ndarray, interval: float, same: bool) -> Lag | None:
    """Rows by which the response follows the command, and the range over the columns; None where it cannot be told.

    Where command and state are the same quantities, each column's lag is where its correlation is highest, and the
    median of the columns that follow counts, if half of the commands that change are followed. Where they are not, it
    is the lag at which the command explains most of the state's next change (least squares beside the state itself).
    Motion in the pictures is compared with the size of the command's changes. The fewer the rows, the higher a
    correlation has to be.

    Args:
        action: commands [T, m].
        response: states [T, n] with n > 1, or motion from one picture to the next [T - 1, 1].
        interval: seconds between rows.
        same: the columns of both are the same quantities.
    """
    longest = min(len(action) // 3, max(2, round(LONGEST_LAG_S / interval)))
    if len(action) < FEWEST_ROWS or longest < 2:
        return None
    if same:
        moving = np.flatnonzero(np.ptp(action, axis=0) > 0)
        peaks = [_peak(action[:, column], response[:, column], longest) for column in moving]
        least = _beyond_chance(SAME, len(action), longest)
        lags = [lag for lag, correlation in peaks if correlation >= least and lag < longest]
        lags = lags if len(lags) >= AGREEING * len(moving) else []
    elif response.shape[1] > 1:
        explained = _explained(action, response, longest)
        least = _beyond_chance(EXPLAINED**0.5, len(action), longest * response.shape[1]) ** 2
        lags = [int(explained.argmax())] if explained.max() >= least else []
    else:
        longest = min(longest, max(2, round(LONGEST_MOTION_LAG_S / interval)))
        change = np.linalg.norm(np.diff(action, axis=0) / (action.std(axis=0) + 1e-9), axis=1)
        lag, correlation = _peak(change, response[: len(change), 0], longest)
        lags = [lag] if correlation >= _beyond_chance(MOVING, len(change), longest) and lag < longest else []
    if not lags:
        return None
    low, middle, high = np.percentile(lags, [10, 50, 90])
    return round(middle), round(low), round(high)


def common_lag(lags: Sequence[Lag | None], rows: Sequence[int]) -> Lag | None:
    """The lag of a recording from those of its parts: the median of those that agree with it.

    Args:
        lags: what :func:`command_lag` says of every part, in one unit.
        rows: of every part; half of all have to be in parts that agree.
    """
    known = [lag is not None for lag in lags]
    if not any(known):
        return None
    found, weight = np.array([lag for lag in lags if lag is not None]), np.asarray(rows)[known]
    middle = np.median(found[:, 0])
    agree = np.abs(found[:, 0] - middle) <= max(1, middle / 4)
    if weight[agree].sum() < AGREEING * sum(rows):
        return None
    low, high = found[agree, 1], found[agree, 2]
    return int(np.median(found[agree, 0])), int(np.median(low)), int(np.median(high))


def _beyond_chance(least: float, rows: int, tries: int) -> float:
    """Correlation over so many rows, the best of ``tries``, whose lower confidence limit (Fisher's z) is ``least``."""
    return float(np.tanh(np.arctanh(least) + NormalDist().inv_cdf(1 - CHANCE / tries) / np.sqrt(rows - 3)))


def _peak(cause: np.ndarray, effect: np.ndarray, longest: int) -> tuple[int, float]:
    """Lag at which the correlation of two series is highest, and that correlation."""
    best = (0, -1.0)
    for lag in range(longest + 1):
        first, second = cause[: len(cause) - lag].astype(float), effect[lag:].astype(float)
        first, second = first - first.mean(), second - second.mean()
        norm = np.sqrt((first @ first) * (second @ second))
        correlation = float(first @ second / norm) if norm > 1e-9 else 0.0
        if correlation > best[1] + 1e-9:
            best = (lag, correlation)
    return best


def _explained(action: np.ndarray, state: np.ndarray, longest: int) -> np.ndarray:
    """Share [longest + 1] of the state's next change that the command of ``lag`` rows ago explains, by lag."""
    state = (state - state.mean(axis=0)) / (state.std(axis=0) + 1e-9)
    action = (action - action.mean(axis=0)) / (action.std(axis=0) + 1e-9)
    now = np.arange(longest, len(state) - 1)
    if len(now) < 2 * (state.shape[1] + action.shape[1] + 1):
        return np.zeros(longest + 1)
    change = state[now + 1] - state[now]
    alone = np.column_stack([state[now], np.ones(len(now))])

    def left_over(columns: np.ndarray) -> np.ndarray:
        return ((change - columns @ np.linalg.lstsq(columns, change, rcond=None)[0]) ** 2).sum(axis=0)

    before = left_over(alone)
    live = before > 1e-9 * len(now)
    if not live.any():
        return np.zeros(longest + 1)
    shares = [
        1 - left_over(np.column_stack([alone, action[now - lag]]))[live] / before[live] for lag in range(longest + 1)
    ]
    return np.max(shares, axis=1)
