"""``tsjepa zoo`` lists the pretrained models; ``verify`` scores them again, and ``train`` makes them again."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from statistics import fmean
from typing import Literal

from scipy.stats import hypergeom

from tsjepa.evaluation.conditions import held_out_loop, load_on, plant_of, warn_of_another_renderer
from tsjepa.evaluation.metrics import normalized_score
from tsjepa.evaluation.rollouts import every, perfect_feedback, run
from tsjepa.models import Controller
from tsjepa.models.entries import names
from tsjepa.zoo.figures import figures, listed, own_rows
from tsjepa.zoo.train import train

VERIFIED_PERIODS = (1, 5)
VERIFIED_SEEDS = 2
NEEDED = ("seeds", "starts_per_seed", "slots", "frame_history", "optimal_policy", "codec", "blend")


def zoo(
    action: Literal["list", "verify", "train"] = "list",
    name: str | None = None,
    *,
    device: str = "cpu",
    seeds: int = 1,
) -> list[dict]:
    """Lists the pretrained models, verifies them, or makes one again from nothing, see :func:`tsjepa.zoo.train.train`.

    Verified entries are hashed, and their loops closed again on some of their card's starts.

    Args:
        action: "list", "verify" or "train".
        name: of one entry, or its folder; all that are shipped by default.
        device: where the models compute while they are verified, such as cuda.
        seeds: of a training, how many; their intervals need at least 2.

    Returns:
        What was printed, as numbers: a dictionary for each entry, or for each loop that was closed again.

    Raises:
        DamagedEntryError: a file is missing or has changed.
        ValueError: an entry scores outside the interval on its card, or no entry to train is named.
        RuntimeError: a step of a training failed.
    """
    if action == "train":
        return [figures(str(train(name or "", seeds)))]
    chosen = names() if name is None else [name]
    if action == "list":
        return listed(chosen)
    failed, scored = [], []
    for entry in chosen:
        checks = rescore(load_on(entry, device), entry)
        print(*(f"{entry}: {check}" for check in checks), sep="\n", flush=True)
        scored += [{"entry": entry, **asdict(check)} for check in checks]
        failed += [entry] if not all(check.passed for check in checks) else []
    if failed:
        raise ValueError(f"Outside the interval of its card: {', '.join(failed)}; train or export it anew.")
    return scored


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
            f"update every {self.update_every}: {self.score:.3f} and {self.failures} failures, its card's figures for "
            f"these starts are {self.expected:.3f} ± {self.interval:.3f} and at most {self.failures_allowed}: "
            f"{'as it says' if self.passed else 'NOT AS IT SAYS'}"
        )


def failures_allowed(row: dict, seeds: int) -> int:
    """How many of the starts of a row's first ``seeds`` seeds may fail.

    What 95 % of the ways to spread the failures of all its starts over them stay within; none where none failed.
    """
    run_again = row["starts"] * seeds // len(row["per_seed"])
    return int(hypergeom.ppf(0.95, row["starts"], row["failures"], run_again))


def rescore(model: Controller, name: str) -> list[Check]:
    """Closes the loops of ``model.metrics`` again on the first of their seeds; every start is one of the card's.

    Raises:
        ValueError: the figures do not say how the model scored, or how that was measured.
    """
    figures = model.metrics
    rows = {period: row for period, row in own_rows(figures).items() if period in VERIFIED_PERIODS}
    plant = plant_of(model)
    if (
        plant is None
        or not rows
        or any("per_seed" not in row for row in rows.values())
        or any(key not in figures for key in NEEDED)
    ):
        raise ValueError(f"The figures of {name} do not say how it scored: export it anew, with `tsjepa export`.")
    warn_of_another_renderer(plant.camera(), figures)
    chosen = figures["seeds"][:VERIFIED_SEEDS]
    loop = held_out_loop(model, plant, blend=figures["blend"], codec=figures["codec"])
    perfect = perfect_feedback(loop, figures["optimal_policy"])
    optimal = [run(perfect, seed).raw_score() for seed in chosen]

    def check(period: int, row: dict) -> Check:
        runs = [run(every(loop, period), seed) for seed in chosen]
        scores = [normalized_score(outcome.raw_score(), best) for outcome, best in zip(runs, optimal, strict=True)]
        return Check(
            update_every=period,
            score=fmean(scores),
            expected=fmean(row["per_seed"][: len(chosen)]),
            interval=row["interval_95"],
            failures=sum(int(outcome.failed().sum()) for outcome in runs),
            failures_allowed=failures_allowed(row, len(chosen)),
        )

    return [check(period, row) for period, row in rows.items()]
