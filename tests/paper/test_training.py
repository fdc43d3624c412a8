"""Points that train: the shipped recipes, cut to what makes the model, on part of a tiny data set."""

import pytest
import tiny

from tsjepa.data.module import Trajectories
from tsjepa.paper import dataset_size, target_snr, training
from tsjepa.paper.command import points_of, recipe_settings

RECIPES = ("recipes/jepa.yaml", "recipes/actor.yaml", "recipes/data.yaml")
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
        recipe = tiny.shrink(tiny.load(name))
        if name == RECIPES[1]:
            recipe["data"]["init_args"]["batch_size"] = 32  # of the 60 rows of a trajectory
        tiny.write(tmp_path, name, recipe)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_a_point_trains_on_its_part_of_the_data_and_closes_its_loops(folder, monkeypatch):
    read = []
    split = Trajectories.split
    monkeypatch.setattr(
        Trajectories, "split", lambda self, name: read.append((name, len(part := split(self, name)))) or part
    )
    rows = training.trained_rows(POINT, [{"update_every": 1, "loss": 0.0}, {"update_every": 5, "loss": 0.5}])
    assert [(row["update_every"], row["seed"]) for row in rows] == [(1, 0), (1, 1), (5, 0), (5, 1)]
    assert ["nmae" in row for row in rows] == [True, True, False, False]
    assert all(0 <= row["failed"] <= 1 for row in rows)
    assert not (folder / "runs").exists()
    assert {("train", 1), ("actor_train", 1)} <= set(read)
    assert max(count for _, count in read) == 1


def test_a_recipe_is_cut_to_the_finishes_that_the_loop_needs():
    shipped = tiny.load(RECIPES[0])["trainer"]["callbacks"]
    kept = {
        callback["class_path"].rpartition(".")[2]: callback["init_args"] for callback in training.finishes(shipped, 7)
    }
    assert set(kept) == set(training.FINISHES)
    assert kept["RefinePredictor"]["steps"] == 7
    (refine,) = [callback for callback in shipped if "Refine" in callback["class_path"]]
    assert kept["RefinePredictor"] == refine["init_args"] | {"steps": 7}
    assert training.finishes(tiny.load(RECIPES[1])["trainer"]["callbacks"], 7) == []


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
