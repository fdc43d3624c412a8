"""Long training does not run here; what it made is loaded and scored again on a few of the card's own starts."""

import json

import pytest
import torch

import tsjepa
from tsjepa import zoo
from tsjepa.envs import Renderer
from tsjepa.envs.expert import Expert, reference_lqr
from tsjepa.evaluation.closed_loop import SemanticPolicy, Starts, run, true_state_policy
from tsjepa.evaluation.metrics import normalized_score

SEEDS = (0, 1)


def score(model, law_name: str, period: int) -> tuple[float, int]:
    """Normalised score and failures over the starts of SEEDS."""
    law = {"expert": Expert, "reference LQR": reference_lqr}[law_name](model.architecture.sampling_interval)
    renderer, raw, optimal, failures = Renderer(), [], [], 0
    for seed in SEEDS:
        starts = Starts(seed, frame_history=model.frame_history)
        loop = run(starts, SemanticPolicy(model, renderer.render, period))
        raw.append(loop.raw_score())
        failures += int(loop.failed().sum())
        optimal.append(run(starts, true_state_policy(law, 1)).raw_score())
    return normalized_score(torch.cat(raw), torch.cat(optimal)), failures


@pytest.mark.parametrize("name", zoo.names())
def test_an_entry_scores_within_its_cards_interval(name):
    metrics = json.loads((zoo.find(name) / zoo.METRICS).read_text())
    model = tsjepa.load(name)
    for row in metrics["closed_loop"]:
        if row["controller"] == "TS-JEPA" and row["update_every"] in (1, 5):
            again, failures = score(model, metrics["optimal_policy"], row["update_every"])
            # two of the card's five seeds: their mean scatters sqrt(5 / 2) as much as the card's
            assert abs(again - row["normalized_score"]) <= 1.6 * row["interval_95"]
            assert failures <= row["failures"]


def test_there_is_a_model_to_load():
    assert "tsjepa-cartpole" in zoo.names()
