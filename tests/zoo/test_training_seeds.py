"""The figures over training seeds: their two intervals, and what the list and the card make of them."""

import json
import math

import pytest
from tiny_controller import tiny
from tiny_data import write

from tsjepa import cli
from tsjepa.evaluation.open_loop import open_loop_metrics
from tsjepa.evaluation.summary import FIRST_LOST
from tsjepa.models import entries
from tsjepa.zoo.card import card
from tsjepa.zoo.figures import SEED_HEADINGS, seed_figures
from tsjepa.zoo.training_seeds import over_seeds, validation_error

T_2, T_1 = 4.302653, 12.706205  # Student's 97.5 % points with 2 and 1 degrees of freedom
WATCHED = {"state": "theta", "limit": 0.05, "unit": "rad"}


def evaluated(every_slot: tuple[float, float], nmae: float, lost: int | None) -> dict:
    """An evaluation on two sets of starts, with these scores at every slot."""
    row = {"controller": "TS-JEPA", "starts": 40}
    once = {"update_every": "once", "per_seed": [0.1, 0.1], "failures": 39, "command_nmae": 0.3}
    return {
        "starts": "2 seeds x 20",
        "seeds": [1000, 1001],
        "slots": 100,
        "optimal_policy": "an LQR",
        "closed_loop": [
            row | {"controller": "expert, perfect feedback", "update_every": 1, "per_seed": [1.0, 1.0]},
            row | {"update_every": 1, "per_seed": list(every_slot), "failures": 2, "command_nmae": nmae},
            row | once | {"watched": WATCHED, FIRST_LOST: lost},
        ],
        "open_loop": {"command_nmae": nmae},
    }


EVALUATIONS = [evaluated((0.8, 1.0), 0.01, 26), evaluated((0.9, 1.1), 0.02, 28), evaluated((1.0, 1.2), 0.03, 30)]


def together(evaluations=EVALUATIONS) -> dict:
    return over_seeds(evaluations, [0.02, 0.01, 0.03], 1, "data/x", "actor_test")


def test_the_two_intervals_are_over_training_seeds_and_over_starts():
    result = together()
    every, once = result["closed_loop"]
    assert every["update_every"] == 1 and once["update_every"] == "once"
    assert every["normalized_score"] == pytest.approx(1.0)
    assert every["per_training_seed"] == pytest.approx([0.9, 1.0, 1.1])
    assert every["per_set_of_starts"] == pytest.approx([0.9, 1.1])
    assert every["interval_95_training_seeds"] == pytest.approx(T_2 * 0.1 / math.sqrt(3), abs=1e-6)
    assert every["interval_95_starts"] == pytest.approx(T_1 * 0.1, abs=1e-5)  # standard deviation .1 sqrt(2)
    assert (every["failures"], every["failures_per_training_seed"], every["starts"]) == (6, [2, 2, 2], 120)
    assert every["command_nmae"] == pytest.approx(0.02)
    assert once["interval_95_training_seeds"] == pytest.approx(0.0, abs=1e-9)
    assert (result["seeds"], result["shipped"], result["start_seeds"]) == ([0, 1, 2], 1, [1000, 1001])
    nmae, lost = result["command_nmae"], result[FIRST_LOST]
    assert (nmae["mean"], nmae["per_training_seed"]) == (pytest.approx(0.02), [0.01, 0.02, 0.03])
    assert nmae["interval_95"] == pytest.approx(T_2 * 0.01 / math.sqrt(3), abs=1e-6)
    assert (lost["mean"], lost["watched"]) == (28.0, WATCHED)
    assert lost["interval_95"] == pytest.approx(T_2 * 2 / math.sqrt(3), abs=1e-4)
    json.dumps(result, allow_nan=False)


def test_figures_of_other_starts_are_refused():
    other = EVALUATIONS[2] | {"seeds": [0, 1]}
    with pytest.raises(ValueError, match="evaluated on different starts"):
        together([*EVALUATIONS[:2], other])


def test_list_and_card_show_the_same_figures(tmp_path, monkeypatch, capsys):
    metrics = {"training_seeds": together()}
    entries.save(tiny(), tmp_path / "made", metrics)
    entries.save(tiny(), tmp_path / "once")
    monkeypatch.setattr(entries, "zoo_folder", lambda: tmp_path)
    assert cli.main(["zoo"]) == 0
    heading, _, line = capsys.readouterr().out.splitlines()[-3:]
    assert [cell.strip() for cell in heading.strip("|").split("|")] == list(SEED_HEADINGS)
    score = "1.000 ± 0.248 ± 1.271"
    cells = ["made", "3", f"{score}, 6 of 120", "-", "-", "-", "0.0200 ± 0.0248", "28.0 ± 5.0"]
    assert [cell.strip() for cell in line.strip("|").split("|")] == cells == list(seed_figures("made").values())
    assert seed_figures("once") is None
    text = card("made", tiny(), metrics).splitlines()
    assert f"| 1 | {score} | 6 of 120 | 0.0200 |" in text
    (said,) = [line for line in text if line.startswith("On recorded test trajectories")]
    assert "is 0.0200 ± 0.0248 over training seeds" in said and "passes 0.05 rad from slot 28.0 ± 5.0 on." in said
    (how,) = [line for line in text if line.startswith("The same recipe with the seeds 0, 1, 2")]
    assert "of seed 1, whose command NMAE on the split actor_test is the smallest: 0.0200, 0.0100, 0.0300." in how
    assert "## Over training seeds" not in card("once", tiny(), {})


@pytest.mark.parametrize(
    ("slots", "shown"), [((26, None, 30), "26, never, 30"), ((None, None, None), "never, never, never")]
)
def test_a_state_that_is_never_lost_has_no_mean_slot(tmp_path, slots, shown):
    evaluations = [evaluated((0.9, 1.0), 0.01, slot) for slot in slots]
    entries.save(tiny(), tmp_path / "made", {"training_seeds": together(evaluations)})
    assert seed_figures(str(tmp_path / "made"))[SEED_HEADINGS[-1]] == shown


def test_models_without_a_watched_state_have_no_slot(tmp_path):
    evaluations = [{**each, "closed_loop": each["closed_loop"][:2]} for each in EVALUATIONS]
    entries.save(tiny(), tmp_path / "made", {"training_seeds": together(evaluations)})
    assert seed_figures(str(tmp_path / "made"))[SEED_HEADINGS[-1]] == "-"


def test_the_validation_error_is_the_command_error_of_the_split(tmp_path):
    model = entries.save(tiny(), tmp_path / "model")
    data = write(tmp_path / "data")
    error = validation_error(str(model), str(data), "actor_test")
    assert error == open_loop_metrics(entries.load(model), str(data), "actor_test")["command_nmae"]
    assert error != validation_error(str(model), str(data), "test")
