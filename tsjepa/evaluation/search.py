"""How many devices a scheduler can serve: score against I, and the largest I whose score stays acceptable."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tsjepa.evaluation.metrics import interval

HOPELESS_SCORE = 0.1  # below it larger fleets are not tried
RIVALS_OF = "channel_aware"
EXACT, AT_LEAST, AT_MOST = "exact", "at least", "at most"
SIGNS = {EXACT: "", AT_LEAST: ">=", AT_MOST: "<="}

Score = Callable[[str, int], list[float]]
"""From scheduler and I to one normalised score per seed; the same seeds, in the same order, every time."""


def search(
    score: Score, schedulers: Sequence[str], sizes: Sequence[int], acceptable: float, resolution: int = 1
) -> dict[str, dict[int, list[float]]]:
    """Scores of every scheduler at the given sizes, and between them where the mean crosses the acceptable score.

    Goes up the sizes until the mean is hopeless, then halves the gap between the largest acceptable size and the first
    that is not, down to ``resolution`` devices.

    Args:
        score: evaluates one fleet; with common random numbers a comparison between schedulers is paired.
        schedulers: names.
        sizes: values of I, ascending.
        acceptable: the mean score that has to be kept.
        resolution: gap between sizes that is not halved any further.

    Returns:
        Scores per seed, by scheduler and by I in ascending order.
    """
    check_sizes(sizes)
    curves = {}
    for scheduler in schedulers:
        curve: dict[int, list[float]] = {}
        for size in sizes:
            curve[size] = score(scheduler, size)
            if mean(curve[size]) < HOPELESS_SCORE:
                break
        good, bad = _bracket({size: mean(values) for size, values in curve.items()}, acceptable)
        while good and bad and bad - good > resolution:
            size = (good + bad) // 2
            curve[size] = score(scheduler, size)
            good, bad = (size, bad) if mean(curve[size]) >= acceptable else (good, size)
        curves[scheduler] = dict(sorted(curve.items()))
    return curves


def check_sizes(sizes: Sequence[int]) -> None:
    """ValueError unless the sizes are two or more, ascending, from 1 up."""
    if list(sizes) != sorted(set(sizes)) or len(sizes) < 2 or sizes[0] < 1:
        raise ValueError(f"search_over is {list(sizes)}; give at least two sizes of the fleet, ascending, from 1 up.")


def mean(values: Sequence[float]) -> float:
    """Arithmetic mean."""
    return sum(values) / len(values)


def _bracket(means: dict[int, float], acceptable: float) -> tuple[int | None, int | None]:
    """The size before the first one that is not acceptable (None if there is none before), and that one (or None)."""
    good = None
    for size, value in sorted(means.items()):
        if value < acceptable:
            return good, size
        good = size
    return good, None


def crossing(curve: dict[int, float], acceptable: float) -> tuple[float, str]:
    """Number of devices at which a curve first falls below the acceptable score, linear between its points.

    Returns:
        The number, and what it is: "exact"; "at least" of a curve that never falls below, which gives its largest size;
        "at most" of one that starts below, which gives its smallest.
    """
    good, bad = _bracket(curve, acceptable)
    if good is None:
        return float(bad), AT_MOST
    if bad is None:
        return float(good), AT_LEAST
    return good + (bad - good) * (curve[good] - acceptable) / (curve[good] - curve[bad]), EXACT


def largest(curves: dict[str, dict[int, list[float]]], acceptable: float) -> list[dict]:
    """One row per scheduler: the largest I whose mean score is acceptable, up to the first that is not.

    ``bound`` is "at least" where no size tried was too much for the scheduler and "at most" where the smallest was.
    Beside it ``per_seed``, where each seed's own curve crosses the acceptable score, with ``bounds_per_seed``, their
    mean and its 95 % interval, and the same of that crossing's distance to channel-aware's on the same seed. A seed
    whose crossing is only bounded leaves no interval (None), and the mean is then bounded too (``mean_bound``).
    """
    found = {name: _crossings(curve, acceptable) for name, curve in curves.items()}
    rows = []
    for name, curve in curves.items():
        good, bad = _bracket({size: mean(values) for size, values in curve.items()}, acceptable)
        crossings, bounds = zip(*found[name], strict=True)
        row = {
            "scheduler": name,
            "largest_num_devices": good if good is not None else bad,
            "bound": AT_MOST if good is None else AT_LEAST if bad is None else EXACT,
            "mean": mean(crossings),
            "mean_bound": _bound_of_mean(bounds),
            "interval_95": interval(list(crossings))[1] if set(bounds) == {EXACT} else None,
            "per_seed": list(crossings),
            "bounds_per_seed": list(bounds),
        }
        if RIVALS_OF in found:
            row |= _ahead(found[RIVALS_OF], found[name])
        rows.append(row)
    return sorted(rows, key=lambda row: -row["mean"])


def _crossings(curve: dict[int, list[float]], acceptable: float) -> list[tuple[float, str]]:
    seeds = len(next(iter(curve.values())))
    return [crossing({size: values[seed] for size, values in curve.items()}, acceptable) for seed in range(seeds)]


def _bound_of_mean(bounds: Sequence[str]) -> str | None:
    """Of a mean of bounded numbers; None where some are bounded from above and others from below."""
    kinds = set(bounds) - {EXACT}
    return EXACT if not kinds else kinds.pop() if len(kinds) == 1 else None


def _ahead(ours: list[tuple[float, str]], theirs: list[tuple[float, str]]) -> dict:
    """How many devices more ``ours`` serves than ``theirs``, seed by seed; nothing unless all crossings are exact."""
    if any(bound != EXACT for _, bound in (*ours, *theirs)):
        return {"channel_aware_ahead_by": None, "ahead_interval_95": None}
    centre, half = interval([our[0] - their[0] for our, their in zip(ours, theirs, strict=True)])
    return {"channel_aware_ahead_by": centre, "ahead_interval_95": half}


def table(rows: list[dict]) -> str:
    """The rows as aligned text; a mean without an interval is bounded as its sign says, or nothing is known of it."""
    lines = [f"{'scheduler':<24}{'largest I':>10}{'over seeds':>18}{'channel-aware ahead by':>26}"]
    for row in rows:
        ahead = row.get("channel_aware_ahead_by")
        ahead = "" if ahead is None else f"{ahead:>17.1f} ± {row['ahead_interval_95']:.1f}"
        count = f"{SIGNS[row['bound']]} {row['largest_num_devices']}"
        if row["mean_bound"] == EXACT:
            over_seeds = f"{row['mean']:.1f} ± {row['interval_95']:<4.1f}"
        else:
            over_seeds = f"{SIGNS[row['mean_bound']]} {row['mean']:.1f}" if row["mean_bound"] else "-"
        lines.append(f"{row['scheduler']:<24}{count:>10}{over_seeds:>18}{ahead:>26}")
    return "\n".join(lines)
