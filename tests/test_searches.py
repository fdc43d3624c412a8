"""The equations of the search for an expert, and the search itself at a size at which it means nothing."""

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
