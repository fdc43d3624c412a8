"""What can go wrong while it runs: a loss that explodes, a GL context that is lost, a worker that is killed."""

from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import DATA, DATA_RECIPE, RECIPE, RUN
from deadly import die, die_once

from tsjepa.data.storage import read_metadata
from tsjepa.plants import CartPole
from tsjepa.support.trust import everything_trusted, may_import
from tsjepa.support.workers import ATTEMPTS, run_items
from tsjepa.training.jepa import TSJEPA

pytestmark = pytest.mark.slow  # every test starts a process, trains or closes loops


def test_a_loss_that_explodes_ends_the_fit_and_keeps_the_last_good_checkpoint(home, command, monkeypatch):
    step = TSJEPA.training_step

    def explode(self, batch, index):
        loss = step(self, batch, index)
        return loss * float("nan") if self.current_epoch == 3 else loss

    monkeypatch.setattr(TSJEPA, "training_step", explode)
    status, complaint = command("fit", "--config", RECIPE, "--ckpt_path", "last", "--trainer.max_epochs", "5")
    assert status == 1
    assert "The loss exploded" in complaint and "epoch 3" in complaint and f"{RUN}/checkpoints/last.ckpt" in complaint
    kept = torch.load(home / RUN / "checkpoints" / "last.ckpt")
    assert kept["epoch"] == 2
    assert all(tensor.isfinite().all() for tensor in kept["state_dict"].values())


def test_weights_that_explode_in_the_last_step_of_an_epoch_are_not_kept(home, command, monkeypatch):
    def spoil(self, outputs, batch, index):
        if self.trainer.is_last_batch and self.current_epoch == 2:
            next(self.predictor.parameters()).data.fill_(float("inf"))

    monkeypatch.setattr(TSJEPA, "on_train_batch_end", spoil)
    status, complaint = command("fit", "--config", RECIPE, "--ckpt_path", "last", "--trainer.max_epochs", "4")
    assert status == 1 and "weights are not finite" in complaint
    assert torch.load(home / RUN / "checkpoints" / "last.ckpt")["epoch"] == 1


def test_a_lost_gl_context_is_made_anew():
    renderer, qpos = CartPole().renderer, np.array([[0.1, 0.2]])
    before = renderer.render(qpos)
    renderer._context.free()
    renderer._gl.free()
    np.testing.assert_array_equal(renderer.render(qpos), before)


@pytest.fixture
def items(tmp_path) -> list[str]:
    return [str(tmp_path / str(number)) for number in range(5)]


def test_a_killed_worker_costs_its_item_and_not_the_run(items):
    assert sorted(run_items(die_once, items, workers=2)) == [(index, str(index)) for index in range(5)]


def test_an_item_that_kills_every_worker_is_named():
    with pytest.raises(RuntimeError, match=f"item 0 were killed {ATTEMPTS} times"):
        list(run_items(die, [0], workers=2))


def test_bad_numbers_of_workers_are_refused():
    with pytest.raises(ValueError, match="workers is 0"):
        list(run_items(die, [0], workers=0))


def test_several_workers_collect_the_same_bytes(home, command):
    assert command("collect", "--config", DATA_RECIPE, "--path", "data/two", "--workers", "2")[0] == 0
    assert read_metadata("data/two")["sha256"] == read_metadata(DATA)["sha256"]


def test_a_killed_worker_of_a_ray_cluster_costs_its_item_and_not_the_run(items):
    ray = pytest.importorskip("ray")
    found_here = {"env_vars": {"PYTHONPATH": str(Path(__file__).parent)}}
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, runtime_env=found_here)
    try:
        assert sorted(run_items(die_once, items, workers="ray")) == [(index, str(index)) for index in range(5)]
    finally:
        ray.shutdown()


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_trust_what_the_process_that_asks_them_trusts(workers):
    """May they import what is not this package's own?"""
    items = ["another_package.Own"] * 3
    with everything_trusted():
        assert {allowed for _, allowed in run_items(may_import, items, workers)} == {True}
        assert may_import(items[0])
    assert not may_import(items[0])
