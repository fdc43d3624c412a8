"""``tsjepa zoo`` lists the pretrained models with their key figures; ``tsjepa zoo verify`` scores them again."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Literal

import torch
from torch import nn

from tsjepa.models.entries import METRICS, find, load, names

LISTED_PERIODS = (1, 5, 10)  # slots between updates
VERIFIED_PERIODS = (1, 5)
VERIFIED_SEEDS = 2


def zoo(action: Literal["list", "verify"] = "list", name: str | None = None) -> None:
    """Lists the pretrained models, or re-hashes them and closes their loops again on some of their card's starts.

    Args:
        action: "list" or "verify".
        name: of one entry, or its folder; all that are shipped by default.

    Raises:
        DamagedEntryError: a file is missing or has changed.
        ValueError: an entry scores outside the interval on its card.
    """
    chosen = names() if name is None else [name]
    if action == "list":
        print(table([key_figures(entry) for entry in chosen]))
        return
    failed = []
    for entry in chosen:
        checks = rescore(load(entry), entry)
        print(*(f"{entry}: {check}" for check in checks), sep="\n", flush=True)
        failed += [entry] if not all(check.passed for check in checks) else []
    if failed:
        raise ValueError(f"Outside the interval of its card: {', '.join(failed)}; train or export it anew.")


def own_rows(metrics: dict) -> dict[int | str, dict]:
    """The closed loops of the model itself, by the slots between updates; none in an entry nobody has evaluated."""
    rows = metrics.get("closed_loop", [])
    # the others are the expert's, which sees the true state
    return {row["update_every"]: row for row in rows if not row["controller"].startswith("expert")}


def key_figures(name: str) -> dict:
    """What the list shows of an entry; None where it was not measured."""
    folder = find(name)
    rows = own_rows(json.loads((folder / METRICS).read_text()))
    every_slot = rows.get(1, {})
    return {
        "name": Path(name).name,
        "scores": [rows.get(period, {}).get("normalized_score") for period in LISTED_PERIODS],
        "command_nmae": every_slot.get("command_nmae"),
        "bits_per_update": every_slot.get("bits_per_step"),
        "megabytes": sum(path.stat().st_size for path in folder.iterdir()) / 1e6,
    }


def table(entries: list[dict]) -> str:
    """The figures as aligned text; the scores are normalised by the optimal policy with perfect feedback."""
    headings = ["every slot", *(f"every {period}" for period in LISTED_PERIODS[1:]), "NMAE", "bit/update", "MB"]
    width = max([len("entry"), *(len(entry["name"]) for entry in entries)]) + 2
    lines = [f"{'entry':<{width}}" + "".join(f"{heading:>12}" for heading in headings)]
    for entry in entries:
        figures = [
            *(_number(score, ".3f") for score in entry["scores"]),
            _number(entry["command_nmae"], ".4f"),
            _number(entry["bits_per_update"], ".0f"),
            _number(entry["megabytes"], ".1f"),
        ]
        lines.append(f"{entry['name']:<{width}}" + "".join(f"{figure:>12}" for figure in figures))
    return "\n".join(lines)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


@dataclass(frozen=True)
class Check:
    """One closed loop scored again.

    Args:
        update_every: slots between updates.
        score: normalised, mean over the seeds that were run again.
        expected: what the card's figures say about the same seeds.
        interval: half-width on the card.
        failures: starts that failed.
        failures_allowed: see :func:`failures_allowed`.
    """

    update_every: int
    score: float
    expected: float
    interval: float
    failures: int
    failures_allowed: int

    @property
    def passed(self) -> bool:
        return abs(self.score - self.expected) <= self.interval and self.failures <= self.failures_allowed

    def __str__(self) -> str:
        return (
            f"update every {self.update_every}: {self.score:.3f} and {self.failures} failures, its card says "
            f"{self.expected:.3f} ± {self.interval:.3f} and at most {self.failures_allowed}: "
            f"{'as it says' if self.passed else 'NOT AS IT SAYS'}"
        )


def failures_allowed(row: dict, seeds: int) -> int:
    """How many of the starts of a row's first ``seeds`` seeds may fail.

    What 95 % of the ways to spread the failures of all its starts over them stay within; none where none failed.
    """
    from scipy.stats import hypergeom

    run_again = row["starts"] * seeds // len(row["per_seed"])
    return int(hypergeom.ppf(0.95, row["starts"], row["failures"], run_again))


def rescore(model: nn.Module, name: str) -> list[Check]:
    """Closes the loops of ``model.metrics`` again on the first of their seeds; every start is one of the card's.

    Raises:
        ValueError: the figures do not say how the model scored, or how that was measured.
    """
    from tsjepa.envs import Renderer
    from tsjepa.envs.embedding_codec import embedding_codec
    from tsjepa.evaluation.closed_loop import SemanticPolicy, Starts, run, true_state_policy
    from tsjepa.evaluation.metrics import normalized_score
    from tsjepa.plants.expert import Expert, reference_lqr

    figures, interval_s = model.metrics, model.spec.slot
    rows = {period: row for period, row in own_rows(figures).items() if period in VERIFIED_PERIODS}
    needed = (
        "seeds",
        "starts_per_seed",
        "slots",
        "frame_history",
        "process_noise_std",
        "optimal_policy",
        "codec",
        "blend",
    )
    if not rows or any("per_seed" not in row for row in rows.values()) or any(key not in figures for key in needed):
        raise ValueError(f"The figures of {name} do not say how it scored: export it anew, with `tsjepa export`.")
    plants = (figures["starts_per_seed"], figures["slots"], figures["frame_history"], interval_s)
    sets = [Starts(seed, *plants, figures["process_noise_std"]) for seed in figures["seeds"][:VERIFIED_SEEDS]]
    law = {"expert": Expert, "reference LQR": reference_lqr}[figures["optimal_policy"]](interval_s)
    optimal = [run(starts, true_state_policy(law, 1)).raw_score() for starts in sets]
    renderer, radio = Renderer(), embedding_codec(figures["codec"], model)

    def sent(embedding: torch.Tensor) -> torch.Tensor:
        return radio.decode(radio.encode(embedding))

    def check(period: int, row: dict) -> Check:
        policies = [SemanticPolicy(model, renderer.render, period, figures["blend"], sent) for _ in sets]
        loops = [run(*pair) for pair in zip(sets, policies, strict=True)]
        return Check(
            update_every=period,
            score=fmean(normalized_score(loop.raw_score(), best) for loop, best in zip(loops, optimal, strict=True)),
            expected=fmean(row["per_seed"][: len(sets)]),
            interval=row["interval_95"],
            failures=sum(int(loop.failed().sum()) for loop in loops),
            failures_allowed=failures_allowed(row, len(sets)),
        )

    return [check(period, row) for period, row in rows.items()]
