"""The key figures of the zoo's entries, read from their metrics.json."""

from __future__ import annotations

import json
from pathlib import Path

from safetensors import safe_open

from tsjepa.evaluation.summary import FIRST_LOST
from tsjepa.models.entries import METRICS, WEIGHTS, find

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


def own_rows(metrics: dict) -> dict[int | str, dict]:
    """The closed loops of the model itself, by the slots between updates; none in an entry nobody has evaluated."""
    rows = metrics.get("closed_loop", [])
    # the others are the expert's, which sees the true state
    return {row["update_every"]: row for row in rows if not row["controller"].startswith("expert")}


def key_figures(name: str) -> dict[str, str]:
    """What the list shows of an entry, by heading: scores with their 95 % intervals; "-" where nobody has measured."""
    folder = find(name)
    metrics = json.loads((folder / METRICS).read_text())
    rows = own_rows(metrics)
    scores = [rows.get(period) for period in LISTED_PERIODS]
    first_lost = rows.get("once", {}).get(FIRST_LOST, "-")
    shown = [
        Path(name).name,
        _int8_bits(folder),
        *("-" if row is None else _score(row) for row in scores),
        f"{metrics['open_loop']['command_nmae']:.4f}" if "open_loop" in metrics else "-",
        "never" if first_lost is None else str(first_lost),
        f"{sum(path.stat().st_size for path in folder.iterdir()) / 1e6:.1f}",
    ]
    return dict(zip(HEADINGS, shown, strict=True))


def _score(row: dict) -> str:
    return f"{row['normalized_score']:.3f} ± {row['interval_95']:.3f}, {row['failures']}"


def _int8_bits(folder: Path) -> str:
    """Bits of an embedding of 8 bits a number; "-" where the entry came without the ranges that it needs."""
    with safe_open(folder / WEIGHTS, "pt") as weights:
        if "code_low" not in weights.keys():  # noqa: SIM118 - not a dictionary
            return "-"
        return str(8 * weights.get_slice("code_low").get_shape()[0])


def table(entries: list[dict[str, str]]) -> str:
    """The figures as a Markdown table; scores are normalised by the normaliser with perfect feedback."""
    lines = [list(HEADINGS), *(list(entry.values()) for entry in entries)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(HEADINGS))]
    padded = [[cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in lines]
    padded.insert(1, ["-" * width for width in widths])
    return "\n".join(f"| {' | '.join(line)} |" for line in padded)
