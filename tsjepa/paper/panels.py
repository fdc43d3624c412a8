"""One device over a property of its model: command error, bits, score and the horizon of one update."""

from __future__ import annotations

from pathlib import Path

from tsjepa.evaluation.rollouts import ONCE
from tsjepa.paper import plots
from tsjepa.paper.rows import CURVE_STEP
from tsjepa.paper.store import flat


def draw_over(records: list[dict], path: str | Path, over: str, name: str, question: str) -> None:
    """Four panels over a field of the points, called ``name`` on the axes; what is not recorded is left out."""
    rows = flat(records)
    values = sorted(plots.distinct(rows, over))
    figure, axes = plots.canvas(columns=4, width=4)

    def groups(period: int) -> list[tuple[int, list[dict]]]:
        found = [(value, plots.select(rows, **{over: value, "update_every": period})) for value in values]
        return [(value, seeds) for value, seeds in found if seeds]

    color = plots.color_of("TS-JEPA")
    for axis, measure, label, title in (
        (axes[0], "nmae", plots.NMAE, "command error"),
        (axes[1], "bits_per_slot", "payload in fp32 (bits per slot)", "payload"),
    ):
        plots.errorbar(axis, groups(1), measure, color=color)
        axis.set(ylabel=label, title=title)
    periods = sorted(set(plots.distinct(rows, "update_every")) - {ONCE})
    for color, period in zip(plots.shades(len(periods)), periods, strict=True):
        plots.errorbar(axes[2], groups(period), "score", color=color, label=f"update every {period} slots")
    axes[2].set(ylabel=plots.SCORE, title="score")
    for axis in axes[:3]:
        axis.set(xlabel=f"{name} (count)", xscale="log")
        axis.set_xticks(values, [str(value) for value in values])
        axis.minorticks_off()
    told_once = groups(ONCE)
    for color, (value, seeds) in zip(plots.shades(len(told_once)), told_once, strict=True):
        curve = plots.curve(seeds, "in_box")
        slots = [CURVE_STEP * (index + 0.5) for index in range(len(curve))]
        axes[3].plot(slots, curve, color=color, linestyle="--", label=f"{value} {name}")
    axes[3].set(xlabel="time since the only update (slots)", ylabel="starts in the box (share)", title="one update")
    plots.legend(figure, axes)
    plots.save(figure, path, question)
