"""The plots of one evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def loop_plot(rows: list[dict], path: Path) -> None:
    """Mean score of the starts against time, one panel a controller, one line an update period."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    controllers = [name for name in dict.fromkeys(row["controller"] for row in rows) if "perfect" not in name]
    perfect = rows[0]["score_by_slot"]
    figure, axes = plt.subplots(1, len(controllers), figsize=(4.2 * len(controllers), 3.2), sharey=True, squeeze=False)
    for axis, name in zip(axes[0], controllers, strict=True):
        axis.plot(perfect, color="black", linewidth=1, linestyle=":", label="expert, perfect feedback")
        for row in rows:
            if row["controller"] == name:
                axis.plot(row["score_by_slot"], label=f"update every {row['update_every']}", linewidth=1.4)
        axis.set(title=name, xlabel="slot", ylim=(0, 1.02))
        axis.legend(fontsize=7)
    axes[0][0].set_ylabel("mean score")
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plt.close(figure)


def horizon_plot(rows: list[dict], optimal_by_slot: list[float], path: Path) -> None:
    """Normalised score of the first h slots against h, of every controller that heard from the device once, at slot 0.

    Args:
        rows: of the evaluation.
        optimal_by_slot: mean score of the optimal policy with perfect feedback after each slot.
        path: of the picture.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    best = np.cumsum(optimal_by_slot)
    horizon = np.arange(1, len(best) + 1)
    scored = best > 0  # before that there is nothing to divide by
    figure, axis = plt.subplots(figsize=(5.6, 3.6))
    axis.axhline(1, color="black", linewidth=1, linestyle=":", label="optimal policy, perfect feedback")
    for row in rows:
        if row["update_every"] == "once":
            score = np.cumsum(row["score_by_slot"])[scored] / best[scored]
            axis.plot(horizon[scored], score, label=row["controller"], linewidth=1.6)
    axis.set(xlabel="slots since the only update", ylabel="normalised score until then", ylim=(0, None))
    axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plt.close(figure)
