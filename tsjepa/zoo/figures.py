"""The key figures of the zoo's entries, read from their metrics.json."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from safetensors import safe_open

from tsjepa.evaluation.summary import FIRST_LOST
from tsjepa.models.entries import METRICS, WEIGHTS, find
from tsjepa.support.files import read_json

LISTED_PERIODS = (1, 5, 10, 20)  # slots between updates
HEADINGS = (
    "entry",
    "bit per update, int8",
    "every slot: score, failures",
    *(f"every {period}" for period in LISTED_PERIODS[1:]),
    "command NMAE",
    "sent once: lost from slot",
    "MB",
)
SEED_HEADINGS = (
    "entry",
    "training seeds",
    "every slot: score, over training seeds, over starts, failures",
    *(f"every {period}" for period in LISTED_PERIODS[1:]),
    "command NMAE",
    "sent once: lost from slot",
)


def own_rows(metrics: dict) -> dict[int | str, dict]:
    """The closed loops of the model itself, by the slots between updates; none in an entry nobody has evaluated."""
    rows = metrics.get("closed_loop", [])
    # the others are the expert's, which sees the true state
    return {row["update_every"]: row for row in rows if not row["controller"].startswith("expert")}


def figures(name: str) -> dict:
    """What the list shows of an entry, as numbers: ``closed_loop`` has a row for each listed number of slots between
    updates that was evaluated, ``training_seeds`` is as in the entry's metrics; None where nobody has measured."""
    folder = find(name)
    metrics = read_json(folder / METRICS)
    rows = own_rows(metrics)
    wanted = ("update_every", "normalized_score", "interval_95", "failures", "starts")
    return {
        "entry": Path(name).name,
        "bits_per_update_int8": _int8_bits(folder),
        "closed_loop": [{key: rows[every][key] for key in wanted} for every in LISTED_PERIODS if every in rows],
        "command_nmae": metrics.get("open_loop", {}).get("command_nmae"),
        "sent_once": {FIRST_LOST: rows["once"][FIRST_LOST]} if FIRST_LOST in rows.get("once", {}) else None,
        "megabytes": sum(path.stat().st_size for path in folder.iterdir()) / 1e6,
        "training_seeds": metrics.get("training_seeds"),
    }


def key_figures(name: str) -> dict[str, str]:
    """The same in words, by heading: scores with their 95 % intervals; "-" where nobody has measured."""
    of = figures(name)
    rows = {row["update_every"]: row for row in of["closed_loop"]}
    scores = [rows.get(period) for period in LISTED_PERIODS]
    first_lost = (of["sent_once"] or {FIRST_LOST: "-"})[FIRST_LOST]
    shown = [
        of["entry"],
        str(of["bits_per_update_int8"] or "-"),
        *("-" if row is None else _score(row) for row in scores),
        "-" if of["command_nmae"] is None else f"{of['command_nmae']:.4f}",
        "never" if first_lost is None else str(first_lost),
        f"{of['megabytes']:.1f}",
    ]
    return dict(zip(HEADINGS, shown, strict=True))


def seed_figures(name: str) -> dict[str, str] | None:
    """What the list shows of the training seeds of an entry's recipe, by heading; None where it was trained once."""
    of_seeds = read_json(find(name) / METRICS).get("training_seeds")
    return None if of_seeds is None else dict(zip(SEED_HEADINGS, [Path(name).name, *seed_cells(of_seeds)], strict=True))


def seed_cells(of_seeds: dict) -> list[str]:
    """The cells below all of :data:`SEED_HEADINGS` but the first."""
    rows = {row["update_every"]: row for row in of_seeds["closed_loop"]}
    scores = [rows.get(period) for period in LISTED_PERIODS]
    nmae = of_seeds["command_nmae"]
    return [
        str(len(of_seeds["seeds"])),
        *("-" if row is None else f"{seed_score(row)}, {row['failures']} of {row['starts']}" for row in scores),
        f"{nmae['mean']:.4f} ± {nmae['interval_95']:.4f}",
        lost_from(of_seeds),
    ]


def seed_score(row: dict) -> str:
    """Mean score with its two intervals: over training seeds, and over the sets of starts."""
    intervals = row["interval_95_training_seeds"], row["interval_95_starts"]
    return " ± ".join(f"{number:.3f}" for number in (row["normalized_score"], *intervals))


def lost_from(of_seeds: dict) -> str:
    """The mean slot from which the watched state is lost; all where a model never loses it; "-" if none is watched."""
    lost = of_seeds.get(FIRST_LOST)
    if lost is None:
        return "-"
    if "mean" in lost:
        return f"{lost['mean']:.1f} ± {lost['interval_95']:.1f}"
    return ", ".join("never" if slot is None else str(slot) for slot in lost["per_training_seed"])


def _score(row: dict) -> str:
    return f"{row['normalized_score']:.3f} ± {row['interval_95']:.3f}, {row['failures']}"


def _int8_bits(folder: Path) -> int | None:
    """Bits of an embedding of 8 bits a number; None where the entry came without the ranges that it needs."""
    with safe_open(folder / WEIGHTS, "pt") as weights:
        if "code_low" not in weights.keys():  # noqa: SIM118 - not a dictionary
            return None
        return 8 * weights.get_slice("code_low").get_shape()[0]


def table(entries: list[dict[str, str]], headings: Sequence[str] = HEADINGS) -> str:
    """The figures as a Markdown table; scores are normalised by the normaliser with perfect feedback."""
    lines = [list(headings), *(list(entry.values()) for entry in entries)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(headings))]
    padded = [[cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in lines]
    padded.insert(1, ["-" * width for width in widths])
    return "\n".join(f"| {' | '.join(line)} |" for line in padded)


def listed(names: list[str]) -> list[dict]:
    """The :func:`figures` of these entries, printed as tables: the models, then those of several training seeds."""
    print(table([key_figures(name) for name in names]))
    seeds = [row for name in names if (row := seed_figures(name)) is not None]
    if seeds:
        print("\nOver training seeds, on starts that no recipe was chosen on:\n")
        print(table(seeds, SEED_HEADINGS))
    return [figures(name) for name in names]
