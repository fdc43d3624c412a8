"""One device over a property of its model: command error, bits, score and the horizon of one update."""

from __future__ import annotations

from pathlib import Path

from tsjepa.evaluation.rollouts import ONCE
from tsjepa.paper import plots
from tsjepa.paper.rows import CURVE_STEP
from tsjepa.paper.store import flat


def draw_over(records: list[dict], path: str | Path, over: str, name: str) -> None:
    """Four panels over a field of the points, called ``name`` on the axes; what is not recorded is left out."""
    rows = flat(records)
    values = sorted(plots.distinct(rows, over))
    figure, axes = plots.canvas(columns=4, width=4)

    def groups(period: int) -> list[tuple[int, list[dict]]]:
        found = [(value, plots.select(rows, **{over: value, "update_every": period})) for value in values]
        return [(value, seeds) for value, seeds in found if seeds]

    for axis, measure, label in ((axes[0], "nmae", "command NMAE"), (axes[1], "bits_per_slot", "bits per slot (fp32)")):
        plots.errorbar(axis, groups(1), measure, color=plots.PALETTE[0])
        axis.set(ylabel=label)
    periods = sorted(set(plots.distinct(rows, "update_every")) - {ONCE})
    for color, period in zip(plots.PALETTE, periods, strict=False):
        plots.errorbar(axes[2], groups(period), "score", color=color, label=f"every {period}")
    axes[2].set(ylabel="normalised score")
    plots.legend(axes[2], fontsize=8, title="slots")
    for axis in axes[:3]:
        axis.set(xlabel=name, xscale="log")
        axis.set_xticks(values, [str(value) for value in values])
        axis.minorticks_off()
    for color, (value, seeds) in zip(plots.PALETTE, groups(ONCE), strict=False):
        curve = plots.curve(seeds, "in_box")
        slots = [CURVE_STEP * (index + 0.5) for index in range(len(curve))]
        axes[3].plot(slots, curve, color=color, label=str(value))
    axes[3].set(xlabel="slots since the only update", ylabel="share of starts in the box")
    plots.legend(axes[3], fontsize=8, title=name)
    plots.save(figure, path)
