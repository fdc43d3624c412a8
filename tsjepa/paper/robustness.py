"""Score and command error where pictures look otherwise than those that a model was trained on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict
from tsjepa.paper.launchers import launch
from tsjepa.paper.rows import appearance_of, command_rows, loop_of, loop_rows
from tsjepa.paper.store import flat

TITLE = "Looks that a model was not trained on"
CAPTION = (
    "Every controller in closed loop where each start looks otherwise: one thing drawn at a time, all of them at once, "
    "and the pictures of another OpenGL driver. A shift of the camera to the side by 1 pixel is 2.7 cm of the cart's "
    "position, of which nothing in the picture tells it apart; up and down it is not. Score and falls as in the figure "
    "of one device; command error (NMAE, over 40 N): its commands beside those of the expert that drives. Models of "
    "the label `appearance` were trained on drawn looks, the others on one. 95 % intervals over seeds."
)
MEASURES = ("score", "nmae")
DRIVER = "GALLIUM_DRIVER"  # Mesa's name for its choice of a driver
TRAINED = "appearance"  # in the label of a model that was trained on drawn looks


def points(models: dict, conditions: list[dict], update_every: list[int], sizes: dict) -> list[dict]:
    """Every model under every condition at every period.

    Args:
        models: entry of the zoo, or its folder, by label.
        conditions: ``condition``, its name; ``appearance``, what is drawn of each start (fields of
            :class:`tsjepa.plants.Appearance`); where given ``driver``, the one of Mesa's that draws, and any of the
            sizes, instead of those below.
        update_every: slots between updates.
        sizes: ``seeds``, ``starts``, ``slots``, ``process_noise_std``.

    Raises:
        ValueError: an appearance that cannot be.
    """
    for condition in conditions:
        appearance_of(condition["appearance"])
    sent = {"sends": "embedding", "codec": "fp32", "between": None}
    return [
        {"label": label, "model": model, "update_every": period} | sent | sizes | condition
        for condition in conditions
        for label, model in models.items()
        for period in update_every
    ]


def evaluate(point: dict) -> list[dict]:
    """Closed loop and command error, one row a seed, with the OpenGL renderer that drew.

    Raises:
        RuntimeError: the driver that the condition names does not draw on this machine.
    """
    driver = point.get("driver")
    if driver is not None and os.environ.get(DRIVER) != driver:
        # OpenGL chooses its driver once in a process
        with environment(DRIVER, driver):
            ((_, (rows, _)),) = launch(__name__, [point], "processes", 2)
        return rows
    renderer = loop_of(point).plant.camera()["gl_renderer"]
    if driver is not None and driver not in renderer:
        raise RuntimeError(
            f"Pictures are drawn by {renderer} although {DRIVER} is {driver}: leave this condition out of the recipe, "
            f"or draw with Mesa (MUJOCO_GL=osmesa)."
        )
    return [
        loop | error | {"gl_renderer": renderer}
        for loop, error in zip(loop_rows(point), command_rows(point), strict=True)
    ]


@contextmanager
def environment(name: str, value: str) -> Iterator[None]:
    """Processes that are started within have the variable."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        os.environ.pop(name)
        if before is not None:
            os.environ[name] = before


def draw(records: list[dict], path: str | Path) -> None:
    """Score and command error, a row a condition, hollow where a model was trained on drawn looks."""
    rows = flat(records)
    names, labels, periods = (plots.distinct(rows, name) for name in ("condition", "label", "update_every"))
    columns = [(measure, period) for measure in MEASURES for period in periods]
    figure, axes = plots.canvas(columns=len(columns), width=3.8, height=1.5 + 0.5 * len(names), sharey=True)
    for axis, (measure, period) in zip(axes, columns, strict=True):
        for number, label in enumerate(labels):
            met = [name for name in names if cell(rows, name, label, period)]
            spreads = [plots.spread(cell(rows, name, label, period), measure) for name in met]
            axis.errorbar(
                [centre for centre, _ in spreads],
                [names.index(name) + 0.7 * (number + 0.5) / len(labels) - 0.35 for name in met],
                xerr=[half for _, half in spreads],
                fmt="o",
                markersize=4,
                capsize=2,
                linewidth=1,
                color=plots.color_of(label),
                markerfacecolor="white" if TRAINED in label else plots.color_of(label),
                label=label,
            )
        if measure == "score":
            axis.set(xlabel=plots.SCORE, title=every(period))
        else:
            axis.set(xlabel=plots.NMAE, title=every(period), xscale="log")
        axis.set_yticks(range(len(names)), names)
        axis.grid(axis="y", alpha=0.3)
    axes[0].invert_yaxis()
    plots.legend(figure, axes, columns=3)
    plots.save(figure, path, "What do other looks cost?")


def table(records: list[dict]) -> str:
    """The means as Markdown: at every period one table of scores and falls and one of command errors."""
    rows = flat(records)
    names, labels, periods = (plots.distinct(rows, name) for name in ("condition", "label", "update_every"))
    lines = []
    for period in periods:
        for measure, title in (("score", "score (falls)"), ("nmae", "command NMAE")):
            lines += [f"| {title}, {every(period)} | starts | {' | '.join(labels)} |", "|---" * (len(labels) + 2) + "|"]
            for name in names:
                cells = [cell(rows, name, label, period) for label in labels]
                starts = next((f"{found[0]['seeds']} x {found[0]['starts']}" for found in cells if found), "")
                say = scored if measure == "score" else erring
                said = [say(found) if found else "" for found in cells]
                lines.append(f"| {name} | {starts} | {' | '.join(said)} |")
            lines.append("")
    return "\n".join(lines)


def cell(rows: list[dict], condition: str, label: str, period: int) -> list[dict]:
    """The rows of a model under a condition, one a seed."""
    return plots.select(rows, condition=condition, label=label, update_every=period)


def scored(rows: list[dict]) -> str:
    """Score with its interval, and in brackets how many starts fell."""
    return f"{plots.text(rows, 'score')} ({round(sum(row['failed'] * row['starts'] for row in rows))})"


def erring(rows: list[dict]) -> str:
    """Command error with its interval."""
    return plots.text(rows, "nmae", 4)


def every(period: int) -> str:
    """What a panel says of its period."""
    return "update in every slot" if period == 1 else f"update every {period} slots"


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """None: the paper claims nothing about it."""
    return {}
