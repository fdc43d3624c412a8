"""What several training seeds of one recipe have made: which of the models is shipped, and how all of them score."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean

import torch

from tsjepa.data.storage import open_split
from tsjepa.evaluation.metrics import interval
from tsjepa.evaluation.open_loop import command_error
from tsjepa.evaluation.summary import FIRST_LOST
from tsjepa.models import entries
from tsjepa.support.provenance import provenance
from tsjepa.training.embeddings import embed_split
from tsjepa.zoo.figures import own_rows

SAME = ("starts", "seeds", "slots", "optimal_policy")  # of every evaluation


@torch.no_grad()
def validation_error(folder: str, data: str, split: str) -> float:
    """How far the commands of the model in ``folder`` are from the expert's on a split, over the actuator's range."""
    model = entries.load(folder)
    rows = embed_split(model.encoder, open_split(data, split), model.frame_spacing).flatten(0, 1)
    return command_error(model, rows)["command_nmae"]


def over_seeds(evaluations: Sequence[dict], errors: Sequence[float], shipped: int, data: str, split: str) -> dict:
    """How the models of the training seeds 0, 1, ... score together.

    Args:
        evaluations: of each, on the same starts, as ``tsjepa evaluate`` writes them.
        errors: of each, see :func:`validation_error`.
        shipped: the one that was chosen by them.
        data, split: what they were measured on.

    Returns:
        What an entry keeps as ``training_seeds`` in its metrics.json. Every interval is the half-width of one of 95 %
        (Student's t): ``interval_95_training_seeds`` over the training seeds, each with its mean over all starts, and
        ``interval_95_starts`` over the sets of starts, each with its mean over the training seeds.

    Raises:
        ValueError: the evaluations are not of the same starts.
    """
    first = evaluations[0]
    for other in evaluations:
        if any(other[key] != first[key] for key in SAME):
            raise ValueError("The training seeds were evaluated on different starts: evaluate them again.")
    rows = [own_rows(evaluation) for evaluation in evaluations]
    result = {
        "made_by": provenance(),
        "seeds": list(range(len(evaluations))),
        "shipped": shipped,
        "validation": {"data": data, "split": split, "command_nmae": list(errors)},
        "starts": first["starts"],
        "start_seeds": first["seeds"],
        "optimal_policy": first["optimal_policy"],
        "closed_loop": [of_period([row[period] for row in rows]) for period in rows[0]],
        "command_nmae": spread([evaluation["open_loop"]["command_nmae"] for evaluation in evaluations]),
    }
    once = [row.get("once", {}) for row in rows]
    if all(FIRST_LOST in row for row in once):
        slots = [row[FIRST_LOST] for row in once]
        lost = {"watched": once[0]["watched"], "per_training_seed": slots}
        result[FIRST_LOST] = lost if None in slots else lost | spread(slots)
    return result


def of_period(rows: Sequence[dict]) -> dict:
    """One period's row over training seeds from theirs."""
    scores = [row["per_seed"] for row in rows]
    by_training_seed, by_starts = [fmean(each) for each in scores], [fmean(each) for each in zip(*scores, strict=True)]
    return {
        "update_every": rows[0]["update_every"],
        "normalized_score": fmean(by_training_seed),
        "interval_95_training_seeds": interval(by_training_seed)[1],
        "interval_95_starts": interval(by_starts)[1],
        "per_training_seed": by_training_seed,
        "per_set_of_starts": by_starts,
        "failures": sum(row["failures"] for row in rows),
        "failures_per_training_seed": [row["failures"] for row in rows],
        "starts": sum(row["starts"] for row in rows),
        "command_nmae": fmean(row["command_nmae"] for row in rows),
    }


def spread(values: Sequence[float]) -> dict:
    """A figure over training seeds."""
    mean, half = interval(list(values))
    return {"mean": mean, "interval_95": half, "per_training_seed": list(values)}
