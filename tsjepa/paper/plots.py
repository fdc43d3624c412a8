"""What the plots share: the style, and means with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tsjepa.evaluation.metrics import interval
from tsjepa.evaluation.style import AGE, NMAE, PALETTE, SCORE, canvas, color_of, legend, line_of, save, shades

__all__ = ["AGE", "NMAE", "PALETTE", "SCORE", "canvas", "color_of", "legend", "line_of", "save", "shades"]


def select(rows: Iterable[dict], **wanted) -> list[dict]:
    """The rows that have all the given values."""
    return [row for row in rows if all(row.get(name) == value for name, value in wanted.items())]


def distinct(rows: Iterable[dict], name: str) -> list:
    """The values of a column, in order of appearance."""
    return list(dict.fromkeys(row[name] for row in rows if name in row))


def mean(rows: Sequence[dict], measure: str) -> float:
    """Mean over the rows, which are one a seed."""
    return sum(row[measure] for row in rows) / len(rows)


def spread(rows: Sequence[dict], measure: str) -> tuple[float, float]:
    """Mean and half-width of the 95 % interval over rows, one a seed; no width where there is one row."""
    values = [row[measure] for row in rows]
    return interval(values) if len(values) > 1 else (values[0], 0.0)


def lead(ours: Sequence[dict], theirs: Sequence[dict], measure: str) -> tuple[float, float]:
    """Mean of ours minus theirs, seed by seed, and half-width of its 95 % interval; both sides have met the same."""
    other = {row["seed"]: row[measure] for row in theirs}
    return interval([row[measure] - other[row["seed"]] for row in ours])


def text(rows: Sequence[dict], measure: str, digits: int = 3) -> str:
    """The mean and its interval, as a report prints them."""
    centre, half = spread(rows, measure)
    return f"{centre:.{digits}f} ± {half:.{digits}f}"


def curve(rows: Sequence[dict], measure: str) -> list[float]:
    """Mean over rows of a measure that is a list."""
    lists = [row[measure] for row in rows]
    return [sum(values) / len(values) for values in zip(*lists, strict=True)]


def errorbar(axis, groups: Sequence[tuple[float, Sequence[dict]]], measure: str, **style) -> None:
    """A line through the means of groups (x, rows), with their intervals."""
    spreads = [spread(rows, measure) for _, rows in groups]
    axis.errorbar(
        [x for x, _ in groups],
        [centre for centre, _ in spreads],
        [half for _, half in spreads],
        capsize=2,
        marker="o",
        markersize=4,
        **style,
    )


def bars(axis, labels: Sequence[str], groups: Sequence[Sequence[dict]], measure: str, colors: Sequence[str]) -> None:
    """Horizontal bars of the groups' means, the first on top, with their intervals."""
    spreads = [spread(rows, measure) for rows in groups]
    axis.barh(
        labels,
        [centre for centre, _ in spreads],
        xerr=[half for _, half in spreads],
        color=colors,
        error_kw={"elinewidth": 1, "capsize": 2},
    )
    axis.invert_yaxis()
