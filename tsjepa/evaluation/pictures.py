"""The plots of one evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tsjepa.evaluation import style


def loop_plot(rows: list[dict], path: Path) -> None:
    """Mean score of the starts against time, one panel a controller, one line an update period."""
    controllers = [name for name in dict.fromkeys(row["controller"] for row in rows) if "perfect" not in name]
    periods = list(dict.fromkeys(row["update_every"] for row in rows))
    colors = dict(zip(periods, style.shades(len(periods)), strict=True))
    figure, axes = style.canvas(columns=len(controllers), width=4.2, height=3.4, sharey=True)
    for axis, name in zip(axes, controllers, strict=True):
        axis.plot(rows[0]["score_by_slot"], color="black", linewidth=1, linestyle=":", label="expert, perfect feedback")
        for row in rows:
            if row["controller"] == name:
                period = row["update_every"]
                label = f"update {period}" if period == "once" else f"update every {period}"
                axis.plot(row["score_by_slot"], label=label, color=colors[period], linewidth=1.4)
        axis.set(title=name, xlabel="time (slots)", ylim=(0, 1.02))
    axes[0].set_ylabel("mean score (0 to 1)")
    style.legend(figure, axes)
    style.save(figure, path, "How rarely may a controller be told?")


def horizon_plot(rows: list[dict], optimal_by_slot: list[float], path: Path) -> None:
    """Normalised score of the first h slots against h, of every controller that heard from the device once, at slot 0.

    Args:
        rows: of the evaluation.
        optimal_by_slot: mean score of the optimal policy with perfect feedback after each slot.
        path: of the picture.
    """
    best = np.cumsum(optimal_by_slot)
    horizon = np.arange(1, len(best) + 1)
    scored = best > 0  # before that there is nothing to divide by
    figure, (axis,) = style.canvas(width=5.6, height=4.2)
    axis.axhline(1, color="black", linewidth=1, linestyle="-.", label="optimal policy, perfect feedback")
    for row in rows:
        if row["update_every"] == "once":
            name, score = row["controller"], np.cumsum(row["score_by_slot"])[scored] / best[scored]
            look = {"color": style.color_of(name), "linestyle": style.line_of(name), "linewidth": 1.6}
            axis.plot(horizon[scored], score, label=name, **look)
    axis.set(xlabel="time since the only update (slots)", ylabel=style.SCORE, ylim=(0, None))
    style.legend(figure, [axis], columns=2)
    style.save(figure, path, "How long does one update last?")
