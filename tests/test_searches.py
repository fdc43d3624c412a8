"""The parts of the searches for laws, and the searches themselves at a size at which they mean nothing."""

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest
import tiny
import torch

from tsjepa.plants import CartPole

HOME = tiny.ROOT / "tests" / "benchmarks"


def test_the_equations_are_mujocos():
    spec = importlib.util.spec_from_file_location("cartpole_equations", HOME / "cartpole_equations.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    plant, generator = CartPole(), np.random.default_rng(0)
    state = generator.uniform(-1, 1, (50, 4)) * [0.8, 0.7, 2.0, 3.0]
    force = generator.uniform(-20, 20, (50, 1))
    expected = plant.stepper.advance(state, force)
    told = module.Equations(plant).step(tuple(torch.from_numpy(state.T)), torch.from_numpy(force[:, 0]))
    np.testing.assert_allclose(torch.stack(told, -1).numpy(), expected, atol=5e-6, rtol=0)


@pytest.mark.slow
def test_a_search_writes_the_law_and_the_plans(tmp_path):
    small = ["--steps", "2", "--terms", "3", "--batch", "4", "--plans", "2", "--output", str(tmp_path / "law.json")]
    subprocess.run([sys.executable, str(HOME / "search_expert.py"), *small], check=True, stdout=subprocess.DEVNULL)
    result = json.loads((tmp_path / "law.json").read_text())
    assert np.shape(result["law"]["directions"]) == (3, 4) and np.shape(result["law"]["heights"]) == (1, 3)
    assert len(result["plans_score_by_seed"]) == 5 and all(0.3 < score < 1 for score in result["plans_score_by_seed"])


@pytest.fixture
def fleet_search(monkeypatch):
    """The module of the search for a fleet's law, with a small fleet."""
    monkeypatch.syspath_prepend(str(HOME))
    module = importlib.import_module("search_fleet_law")
    monkeypatch.setattr(module, "DEVICES", 12)
    monkeypatch.setattr(module, "SLOTS", 60)
    return module


def test_the_evolution_strategy_climbs_a_hill_that_is_thirty_times_as_narrow_one_way(fleet_search):
    top, width = torch.linspace(-1, 1, 6), torch.logspace(0, 1.5, 6)
    evolution = fleet_search.Evolution(torch.zeros(6), 0.5, torch.Generator().manual_seed(0))
    for _ in range(150):
        samples = evolution.ask()
        evolution.tell(-((samples - top) * width).square().sum(-1))
    assert ((evolution.mean - top) * width).norm() < 1e-3


def test_machines_of_the_search_fall_unless_they_are_heard(fleet_search):
    given = fleet_search.world((60,))
    expert = fleet_search.law_of("expert")
    _, always = fleet_search.score(expert, 1, given, always=True)
    _, never = fleet_search.score(expert, 1, given._replace(delivered=torch.zeros_like(given.delivered)))
    assert always == 0 and never == 1


@pytest.mark.slow
def test_a_search_for_fleets_writes_a_law_that_acts_as_in_the_search(fleet_search, tmp_path, monkeypatch):
    small = ["--generations", "2", "--terms", "3", "--output", str(tmp_path / "law.json")]
    monkeypatch.setattr("sys.argv", ["search_fleet_law.py", *small])
    fleet_search.main()
    result = json.loads((tmp_path / "law.json").read_text())
    assert np.shape(result["law"]["directions"]) == (3, 4) and 0 < result["normalised_score"]["found"] < 1.5
    laws = fleet_search.Laws(torch.randn(2, 6 + 5 * 3, generator=torch.Generator().manual_seed(1)))
    states = torch.randn(2, 50, 4, generator=torch.Generator().manual_seed(2))
    torch.testing.assert_close(laws.module()(states[0])[:, 0], laws(states)[0], atol=1e-3, rtol=0)
