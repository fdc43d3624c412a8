"""Embedding dimension, one device (paper fig_ts-jepa_pred_Enc_op)."""

from __future__ import annotations

from pathlib import Path

from tsjepa.paper import one_device, plots
from tsjepa.paper.claims import Verdict, judge, setbacks
from tsjepa.paper.panels import draw_over
from tsjepa.paper.store import flat

TITLE = "Embedding dimension"
CAPTION = (
    "The zoo's TS-JEPA controllers of 16 to 256 dimensions: command error beside the expert that drives (every slot), "
    "bits of an fp32 embedding, normalised score with an update in every slot, every 5 and every 10, and the share of "
    "starts in the box after one update at the start. 95 % intervals over evaluation seeds; one training seed each. "
    "The entries of 32, 64 and 128 have a quarter of the encoder's features that those of 16 and 256 have, so that "
    "small differences say nothing of the width."
)
MEASURES = ("score", "nmae")
evaluate = one_device.evaluate


def points(models: dict, update_every: list[int], sizes: dict) -> list[dict]:
    """The sweep.

    Args:
        models: entry of the zoo by dimension.
        update_every: slots between updates; 0 is once.
        sizes: ``seeds``, ``starts``, ``slots``, ``process_noise_std``.
    """
    common = {"sends": "embedding", "codec": "fp32", "between": "predict"}
    return [
        {"dimension": int(dimension), "model": model, "update_every": period} | common | sizes
        for period in update_every
        for dimension, model in models.items()
    ]


def draw(records: list[dict], path: str | Path) -> None:
    """Command error, bits, score and the horizon of one update."""
    draw_over(records, path, "dimension", "numbers in an embedding", "How small may an embedding be?")


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """Trends from the smallest to the largest dimension."""
    rows = flat(records)

    def means(period: int, measure: str) -> dict[int, float]:
        shown = plots.select(rows, update_every=period)
        dimensions = sorted(plots.distinct(shown, "dimension"))
        return {d: plots.mean(plots.select(shown, dimension=d), measure) for d in dimensions}

    errors, bits, scores = means(1, "nmae"), means(1, "bits_per_slot"), means(10, "score")
    found = {}
    if len(errors) > 1:
        found["dimension_nmae"] = judge(
            not setbacks(errors, rising=False),
            f"command NMAE {listed(errors, 4)}",
            setbacks(errors, rising=False),
            partly=errors[max(errors)] < errors[min(errors)],
        )
        found["dimension_bits"] = judge(not setbacks(bits), f"bits per slot {listed(bits, 0)}", setbacks(bits))
    if len(scores) > 1:
        tenth = plots.select(rows, update_every=10)
        largest, smallest = (plots.select(tenth, dimension=end(scores)) for end in (max, min))
        gain, half = plots.lead(largest, smallest, "score")
        found["dimension_score"] = judge(
            not setbacks(scores) and gain > half,
            f"normalised score with an update every 10 slots {listed(scores, 3)}; the largest leads the smallest by "
            f"{gain:.3f} ± {half:.3f}",
            "; ".join(
                [setbacks(scores)] * bool(setbacks(scores)) + ["the lead lies within its interval"] * (gain <= half)
            ),
            partly=gain > half,
        )
    return found


def listed(values: dict[int, float], digits: int) -> str:
    """Values by dimension in words."""
    return ", ".join(f"{value:.{digits}f} (d = {dimension})" for dimension, value in values.items())
