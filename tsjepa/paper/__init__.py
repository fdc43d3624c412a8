"""The paper's figures and three of ours, one module each.

A module of a figure has

- ``TITLE`` and ``CAPTION``, what it shows and how it was measured;
- ``MEASURES``, the columns of its rows that ``make figures-check`` compares;
- ``points(**settings)``, its sweep: a list of dicts of plain values, from the settings in ``recipes/figures``;
- ``evaluate(point)``, a pure function to rows, dicts of numbers, one or more a seed;
- ``draw(records, path)``, the plot, from recorded results alone;
- ``verdicts(records)``, what they say about the paper's claims, by the claim's name in :mod:`.claims`;
- where it has one ``table(records)``, the same as Markdown, which is printed when it is drawn.
"""

from __future__ import annotations

import importlib
from types import ModuleType

FIGURES = (
    "frame_change",
    "tsne",
    "one_device",
    "dimension",
    "dataset_size",
    "target_snr",
    "devices_encoding",
    "devices_prediction",
    "bits",
    "schedulers",
    "robustness",
)


def module_of(figure: str) -> ModuleType:
    """The module of a figure.

    Raises:
        ValueError: there is no such figure.
    """
    if figure not in FIGURES:
        raise ValueError(f"There is no figure {figure!r}; choose from {', '.join(FIGURES)}.")
    return importlib.import_module(f"{__name__}.{figure}")
