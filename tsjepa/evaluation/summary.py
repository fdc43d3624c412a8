"""The rows of an evaluation's table: their figures, and the table as text."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from tsjepa.evaluation.metrics import Run, interval, normalized_score
from tsjepa.support.spec import PlantSpec

FIRST_LOST, ERRORS = "first_slot_watched_error_above_limit", "watched_error_by_slot"


def summary(name: str, period: int, runs: Sequence[Run], optimal: list[Tensor]) -> dict:
    """One row of the table: means over all starts, intervals over seeds."""
    scores = [normalized_score(loop.raw_score(), best) for loop, best in zip(runs, optimal, strict=True)]
    mean, half = interval(scores)
    row = {
        "controller": name,
        "update_every": period or "once",
        "normalized_score": mean,
        "interval_95": half,
        "best_seed": max(scores),
        "per_seed": scores,
        "raw_score": _mean(runs, Run.raw_score),
        "failures": int(torch.cat([loop.failed() for loop in runs]).sum()),
        "starts": sum(len(best) for best in optimal),
        "command_nmae": _mean(runs, Run.command_nmae),
        "bits_per_step": _mean(runs, lambda loop: loop.payload_bits.double().flatten()),
        "score_by_slot": score_by_slot(runs),
    }
    return row if runs[0].cost is None else row | {"quadratic_cost": _mean(runs, Run.quadratic_cost)}


def _mean(runs: Sequence[Run], figure: Callable[[Run], Tensor]) -> float:
    return float(torch.cat([figure(loop) for loop in runs]).mean())


def score_by_slot(runs: Sequence[Run]) -> list[float]:
    """Mean score of all starts after each slot."""
    return torch.cat([loop.slot_score() for loop in runs], dim=1).mean(1).tolist()


def table(result: dict) -> str:
    """The rows as aligned text."""
    lines, closed_loop = [], result.get("closed_loop", [])
    if closed_loop:
        cost = f"{'cost':>9}" if "quadratic_cost" in closed_loop[0] else ""
        lines.append(
            f"{'controller':<26}{'update':>7}{'score':>16}{'raw':>7}{'fail':>9}{cost}{'NMAE':>8}{'bit/step':>10}"
        )
    for row in closed_loop:
        cost = f"{row['quadratic_cost']:>9.1f}" if "quadratic_cost" in row else ""
        lines.append(
            f"{row['controller']:<26}{row['update_every']:>7}{row['normalized_score']:>8.3f} ± {row['interval_95']:.3f}"
            f"{row['raw_score']:>7.3f}{row['failures']:>5}/{row['starts']:<3}{cost}"
            f"{row['command_nmae']:>8.4f}{row['bits_per_step']:>10.0f}"
        )
        if FIRST_LOST in row:
            slot = "never" if row[FIRST_LOST] is None else f"from slot {row[FIRST_LOST]}"
            lines.append("  probed {state} more than {limit:g} {unit} off: ".format(**row["watched"]) + slot)
    lines += [f"{name}: {value}" for name, value in result.get("open_loop", {}).items()]
    return "\n".join(lines)


def watched_figures(errors: Tensor, spec: PlantSpec) -> dict:
    """Of errors [T, N] of the watched state: their mean over starts, and the first slot where it passes the limit.

    That slot is None if the mean never does.
    """
    mean = errors.mean(1)
    above = (mean > spec.watched_limit).nonzero()
    unit = spec.state_units[spec.state_names.index(spec.watched)] if spec.state_units else ""
    return {
        "watched": {"state": spec.watched, "limit": spec.watched_limit, "unit": unit},
        FIRST_LOST: int(above[0]) if len(above) else None,
        ERRORS: mean.tolist(),
    }
