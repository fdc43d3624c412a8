"""Training data-set size, one device (paper fig_ts-jepa_pred_training_size)."""

from __future__ import annotations

from pathlib import Path

from tsjepa.evaluation.rollouts import ONCE
from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict, judge, setbacks
from tsjepa.paper.panels import draw_over
from tsjepa.paper.store import flat
from tsjepa.paper.training import trained_rows

TITLE = "Training data-set size"
CAPTION = (
    "TS-JEPA and its actor trained by the shipped recipes with a fraction of their steps, the same for every point, on "
    "the first 25, 50, 100 or 180 training trajectories; one training seed, on a CPU."
)
MEASURES = ("score", "nmae")
COLLAPSED, LOWER = 0.5, 0.8  # of the effective rank with the most data
LOOPS = (1, 5, 10, ONCE)


def points(train_episodes: list[int], training_seeds: list[int], budget: dict, sizes: dict) -> list[dict]:
    """The sweep.

    Args:
        train_episodes: trajectories that TS-JEPA and its predictor are trained on.
        training_seeds: of the weights and batches.
        budget: see :func:`trained_rows`.
        sizes: ``seeds``, ``starts``, ``slots``, ``process_noise_std``.
    """
    return [
        {"train_episodes": episodes, "training_seed": seed} | budget | sizes
        for episodes in train_episodes
        for seed in training_seeds
    ]


def evaluate(point: dict) -> list[dict]:
    """Trains, then closes the loop with an update in every slot, every 5, every 10, and once."""
    return trained_rows(point, [{"update_every": period} for period in LOOPS])


def draw(records: list[dict], path: str | Path) -> None:
    """Command error, bits, score and the horizon of one update."""
    draw_over(records, path, "train_episodes", "training trajectories", "How much data is enough?")


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """Trends from the smallest to the largest data set."""
    rows = flat(records)
    sizes = sorted(plots.distinct(rows, "train_episodes"))
    if len(sizes) < 2:
        return {}

    def means(period: int, measure: str) -> dict[int, float]:
        shown = {size: plots.select(rows, train_episodes=size, update_every=period) for size in sizes}
        return {size: plots.mean(trained, measure) for size, trained in shown.items()}

    def listed(values: dict[int, float], digits: int) -> str:
        return ", ".join(f"{value:.{digits}f} ({size})" for size, value in values.items())

    errors, bits, scores = means(1, "nmae"), means(1, "bits_per_slot"), means(10, "score")
    ranks = means(1, "effective_rank")
    fewest, most = sizes[0], sizes[-1]
    return {
        "data_nmae": judge(
            not setbacks(errors, rising=False),
            f"command NMAE by trajectories: {listed(errors, 4)}",
            setbacks(errors, rising=False),
            partly=errors[most] < errors[fewest],
        ),
        "data_bits": judge(
            bits[most] > bits[fewest],
            f"bits per slot by trajectories: {listed(bits, 0)}",
            setbacks(bits),
        ),
        "data_collapse": judge(
            ranks[fewest] < COLLAPSED * ranks[most],
            f"effective rank of the embeddings by trajectories: {listed(ranks, 1)}",
            f"with the fewest it is {ranks[fewest] / ranks[most]:.2f} times that with the most",
            partly=ranks[fewest] < LOWER * ranks[most],
        ),
        "data_score": judge(
            not setbacks(scores),
            f"normalised score with an update every 10 slots, by trajectories: {listed(scores, 3)}",
            setbacks(scores),
            partly=scores[most] > scores[fewest],
        ),
    }
