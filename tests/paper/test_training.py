"""Points that train: the shipped recipes, cut to what makes the model, on part of a tiny data set."""

import pytest
import tiny
import yaml

from tsjepa.paper import dataset_size, target_snr, training
from tsjepa.paper.command import points_of, recipe_settings

RECIPES = ("recipes/smoke.yaml", "recipes/smoke-actor.yaml", "recipes/smoke-data.yaml")
BUDGET = {
    "jepa_recipe": RECIPES[0],
    "actor_recipe": RECIPES[1],
    "jepa_steps": 2,
    "predictor_steps": 2,
    "actor_steps": 2,
}
POINT = BUDGET | {"train_episodes": 1, "actor_episodes": 1, "training_seed": 0}
POINT |= {"seeds": 2, "starts": 6, "slots": 100, "process_noise_std": 0.0}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name in RECIPES:
        tiny.write(tmp_path, name, tiny.shrink(tiny.load(name)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_point_trains_on_its_part_of_the_data_and_closes_its_loops(folder):
    rows = training.trained_rows(POINT, [{"update_every": 1, "loss": 0.0}, {"update_every": 5, "loss": 0.5}])
    assert [(row["update_every"], row["seed"]) for row in rows] == [(1, 0), (1, 1), (5, 0), (5, 1)]
    assert ["nmae" in row for row in rows] == [True, True, False, False]
    assert all(0 <= row["failed"] <= 1 for row in rows)
    assert not (folder / "runs").exists()
    parts = training.PartOfTrajectories(1, path="data/smoke")
    assert len(parts.split("train")) == 1
    assert len(parts.split("validation")) == 2
    parts = training.PartOfPairs(2, 1, path="data/smoke")
    assert (len(parts.split("train")), len(parts.split("actor_train"))) == (2, 1)


@pytest.mark.parametrize("name", ["recipes/jepa.yaml", "recipes/actor.yaml"])
def test_a_recipe_is_cut_to_what_makes_the_model(name, tmp_path):
    recipe = tiny.load(name)
    training.shorten(recipe, tmp_path / "model", 7, {"RefinePredictor": 3, "FitProbe": 1})
    trainer = recipe["trainer"]
    callbacks = {callback["class_path"].rpartition(".")[2]: callback["init_args"] for callback in trainer["callbacks"]}
    assert callbacks["ExportModel"] == {"folder": str(tmp_path / "model")}
    assert callbacks.get("RefinePredictor", {"steps": 3})["steps"] == 3
    assert set(callbacks) <= set(training.KEPT)
    assert trainer["max_steps"] == 7
    assert "runs" not in yaml.safe_dump(trainer)


def test_a_lower_target_leaves_fewer_trajectories():
    points = points_of(target_snr, recipe_settings("target_snr"))
    assert [(point["data"], point["train_episodes"]) for point in points] == [
        ("thinned", 66),
        ("thinned", 131),
        ("thinned", 174),
        ("all data", 180),
    ]
    assert target_snr.outage(5, 5) == pytest.approx(0.632, abs=1e-3)


def test_the_sweep_of_the_data_set_shares_one_budget():
    points = points_of(dataset_size, recipe_settings("dataset_size"))
    assert [point["train_episodes"] for point in points] == [25, 50, 100, 180]
    assert len({tuple((name, point[name]) for name in BUDGET) for point in points}) == 1
