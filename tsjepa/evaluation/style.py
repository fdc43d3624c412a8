"""One style for every figure: a colour for each method, units on axes, a question above, no legend over data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tsjepa.support.files import whole

# Okabe and Ito's colours, told apart by colour-blind readers
PALETTE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#5D3A9B", "#8C6D31", "#999999")
METHODS = {
    "TS-JEPA": "#D55E00",
    "supervised 4": "#56B4E9",
    "supervised": "#0072B2",
    "autoencoder": "#009E73",
    "expert": "#000000",
    "optimal": "#000000",
}
SCHEDULERS = {
    "oracle": "#000000",
    "channel_aware": "#D55E00",
    "whittle": "#E69F00",
    "max_weight": "#999999",
    "max_age": "#CC79A7",
    "opportunistic": "#0072B2",
    "proportional_fair": "#009E73",
    "round_robin": "#56B4E9",
    "random": "#8C6D31",
    "channel_aware_literal": "#5D3A9B",
}
SCORE = "normalised score (1: perfect feedback)"
AGE = "age of information (slots)"
NMAE = "command NMAE (share of the range)"


def color_of(name: str) -> str:
    """The colour of a method or a scheduler, the same in every figure; a name that is not known decides by itself."""
    if name in SCHEDULERS:
        return SCHEDULERS[name]
    own = [color for method, color in METHODS.items() if name.startswith(method)]
    return own[0] if own else PALETTE[sum(name.encode()) % len(PALETTE)]


def line_of(name: str) -> str:
    """The line of a method: dashed where its command is held between updates, dotted where it rests."""
    return "--" if "hold" in name or "held" in name else ":" if "zero" in name else "-"


def shades(count: int) -> list[Any]:
    """Colours from dark to light, for lines that differ in an amount."""
    import matplotlib

    return [matplotlib.colormaps["viridis"](0.9 * index / max(1, count - 1)) for index in range(count)]


def canvas(columns: int = 1, rows: int = 1, width: float = 5.2, height: float = 3.8, **options) -> tuple[Any, list]:
    """A figure and its axes, a list row by row."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    size = (width * columns, height * rows)
    figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained", **options)
    return figure, list(axes.flat)


def legend(figure: Any, axes: Sequence[Any], title: str | None = None, columns: int = 5) -> None:
    """One legend below all panels, of what is drawn in any of ``axes``."""
    handles: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        options = {"loc": "outside lower center", "ncols": min(columns, len(handles)), "fontsize": 8, "title": title}
        figure.legend(list(handles.values()), list(handles), **options)


def save(figure: Any, path: str | Path, question: str) -> None:
    """Writes the picture, the question that it answers above it, and frees it."""
    import matplotlib.pyplot as plt

    figure.suptitle(question, fontsize=12)
    with whole(path, Path(path).suffix) as partial:
        figure.savefig(partial, dpi=110)
    plt.close(figure)
