"""``tsjepa figures``: redraws the figures from recorded results, runs their sweeps where asked, or checks them."""

from __future__ import annotations

import inspect
from pathlib import Path
from types import ModuleType
from typing import Literal

import yaml

from tsjepa.paper import FIGURES, module_of, store
from tsjepa.paper.sweep import check as check_figure
from tsjepa.paper.sweep import run_sweep
from tsjepa.support.checks import at_least
from tsjepa.support.processor import cores
from tsjepa.support.recipes import find_recipe

RESULTS = "docs/results/figures"


def figures(
    figure: str | None = None,
    settings: dict | None = None,
    recompute: bool = False,
    check: bool = False,
    launcher: Literal["serial", "processes", "ray"] = "serial",
    workers: int | None = None,
    results: str = RESULTS,
) -> list[dict]:
    """Redraws figures from what is recorded; no sweep runs unless asked for.

    Args:
        figure: name of one, all of them by default.
        settings: of its sweep; those of recipes/figures/FIGURE.yaml by default.
        recompute: run the sweep: points that are recorded, with the same weights, recipes and code, are kept, so that
            an interrupted sweep goes on. Delete the figure's .json file to run all of it anew.
        check: run the quickest recorded point of each sweep again, and fail unless it lies in its recorded interval.
        launcher: one point after the other, over processes, or over a Ray cluster (extra `ray`).
        workers: processes at a time, by default one a core.
        results: folder of the recorded results and the pictures; sweeps of two figures may fill it at once.

    Returns:
        Each figure with the number of its recorded points; with ``check``, the values that were repeated.
    """
    if settings is not None and figure is None:
        raise ValueError("settings belong to one figure: name it, as in --figure bits.")
    if settings is not None and not recompute and settings != recipe_settings(str(figure)):
        raise ValueError("settings are those of a sweep, and none is run: add --recompute true, or leave settings out.")
    if check and recompute:
        raise ValueError("check repeats points that are recorded, and recompute makes them anew: choose one.")
    if workers is not None:
        at_least(1, workers=workers)
    names = FIGURES if figure is None else (figure,)
    if check:
        return check_all(names, results, launcher)
    drawn = []
    for name in names:
        module = module_of(name)
        if recompute:
            points = points_of(module, settings or recipe_settings(name))
            run_sweep(module, points, results, launcher, workers or cores())
        drawn.append({"figure": name, "points": redraw(module, results)})
    return drawn


def recipe_settings(figure: str) -> dict:
    """The settings that the figure's recipe ships."""
    return yaml.safe_load(Path(find_recipe(f"recipes/figures/{figure}.yaml")).read_text())["settings"]


def points_of(module: ModuleType, settings: dict) -> list[dict]:
    """The sweep of a figure.

    Raises:
        ValueError: the settings are not those that the figure takes.
    """
    taken = set(inspect.signature(module.points).parameters)
    if set(settings) != taken:
        raise ValueError(
            f"The settings of {module.__name__.rpartition('.')[2]} are {', '.join(sorted(taken))}; "
            f"given were {', '.join(sorted(settings)) or 'none'}."
        )
    return module.points(**settings)


def redraw(module: ModuleType, folder: str | Path) -> int:
    """Draws one figure from its recorded results, whose number it returns; one sentence where there are none."""
    name = module.__name__.rpartition(".")[2]
    records = store.read(folder, name)
    if not records:
        print(f"{name}: nothing recorded yet; tsjepa figures --config recipes/figures/{name}.yaml --recompute true")
        return 0
    path = Path(folder) / f"{name}.png"
    module.draw(records, path)
    print(f"{name}: {path}, from {len(records)} recorded points.")
    if hasattr(module, "table"):
        print(module.table(records))
    return len(records)


def check_all(names: tuple[str, ...], folder: str, launcher: str) -> list[dict]:
    """Prints and returns recorded and repeated values; RuntimeError where one left its interval."""
    strays, repeated = [], []
    for name in names:
        rows = check_figure(module_of(name), store.read(folder, name), launcher)
        if not rows:
            print(f"{name}: nothing is recorded with the weights and recipes that are here, so nothing is repeated.")
        for row in rows:
            print(
                f"{name:<20}{row['measure']:<18}recorded {row['recorded']:>10.4g} ± {row['interval_95']:<9.3g} now "
                f"{row['now']:>10.4g}  {'agrees' if row['agrees'] else 'DIFFERS'}"
            )
        repeated += [{"figure": name, **row} for row in rows]
        strays += [f"{name} ({row['measure']} at {row['point']})" for row in rows if not row["agrees"]]
    if strays:
        raise RuntimeError(f"These points left their recorded interval: {'; '.join(strays)}.")
    return repeated
