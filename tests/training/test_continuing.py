"""A fit that goes on from a checkpoint says what differs from its run, and does as the recipe says."""

import pytest
import tiny
import tiny_data
import torch
from torch.optim.lr_scheduler import LambdaLR, StepLR

from tsjepa import cli
from tsjepa.support.precision import Precision
from tsjepa.training import run
from tsjepa.training.continuing import changes, other_sizes, set_options, set_schedule


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with a tiny run of one epoch, its data set and another one."""
    home = tmp_path_factory.mktemp("continuing")
    recipe = tiny.shrink(tiny.load("recipes/jepa.yaml"))
    recipe["trainer"] |= {"max_epochs": 1, "callbacks": [], "limit_val_batches": 0}
    tiny.write(home, "recipe.yaml", recipe)
    path = recipe["data"]["init_args"]["path"]
    tiny_data.write(home / path, slots=40)
    tiny_data.write(home / "data/other", slots=40, seed=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        assert cli.main(["fit", "--config", "recipe.yaml"]) == 0
    return home


def go_on(finished, monkeypatch, *options: str) -> int:
    monkeypatch.chdir(finished)
    return cli.main(["fit", "--config", "recipe.yaml", "--ckpt_path", "last", *options])


@pytest.mark.slow
def test_another_data_set_is_refused_unless_it_is_told(finished, monkeypatch, capsys):
    other = ["--data.init_args.path", "data/other", "--trainer.max_epochs", "2"]
    before = (finished / "runs/jepa/checkpoints/last.ckpt").read_bytes()
    assert go_on(finished, monkeypatch, *other) == 2
    said = capsys.readouterr()
    assert "Continued: data.init_args.path is data/other, the run had data/cartpole.\n" in said.out
    assert said.err.splitlines()[-1].startswith("tsjepa fit: The checkpoint is of a run on another data set, data/cart")
    assert said.err.splitlines()[-1].endswith("add --other_data true.")
    assert (finished / "runs/jepa/checkpoints/last.ckpt").read_bytes() == before


@pytest.mark.slow
def test_another_embedding_dimension_is_one_sentence(finished, monkeypatch, capsys):
    sizes = [f"--model.init_args.{part}.init_args.embedding_dim" for part in ("encoder", "predictor")]
    assert go_on(finished, monkeypatch, sizes[0], "24", sizes[1], "24") == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        "tsjepa fit: The checkpoint is of another model than the recipe's: "
        "model.init_args.encoder.init_args.embedding_dim is 24, the run had 16; "
        "model.init_args.predictor.init_args.embedding_dim is 24, the run had 16. Give the run's own sizes."
    )


@pytest.mark.slow
def test_the_recipes_learning_rate_rules_and_every_change_is_said(finished, monkeypatch, capsys):
    rate = ["--model.init_args.optimizer.init_args.lr", "0.5e-3"]
    assert go_on(finished, monkeypatch, *rate, "--trainer.max_epochs", "2") == 0
    said = capsys.readouterr().out
    assert "Continued: trainer.max_epochs is 2, the run had 1.\n" in said
    assert "Continued: model.init_args.optimizer.init_args.lr is 0.0005, the run had 0.001.\n" in said
    assert "From here on lr is 0.0005, the checkpoint had 0.001." in said
    checkpoint = torch.load(finished / "runs/jepa/checkpoints/last.ckpt", weights_only=True)
    assert checkpoint["epoch"] == 1
    (group,) = checkpoint["optimizer_states"][0]["param_groups"]
    assert group["initial_lr"] == 0.0005 and group["lr"] <= 0.0005
    assert checkpoint["lr_schedulers"][0]["base_lrs"] == [0.0005]


def test_every_setting_that_differs_is_a_line_and_nothing_else():
    stored = {"trainer": {"max_epochs": 30, "logger": None}, "data": {"steps": [1, 2], "parts": [{"a": 1}, {"b": 2}]}}
    given = {"trainer": {"max_epochs": 31}, "data": {"steps": [1, 4], "parts": [{"a": 1}, {"b": 3}]}}
    assert changes(stored, given | {"ckpt_path": "last", "seed_everything": 1}) == [
        "trainer.max_epochs is 31, the run had 30",
        "data.steps is [1, 4], the run had [1, 2]",
        "data.parts[1].b is 3, the run had 2",
        "seed_everything is 1, the run had nothing",
    ]
    assert changes(stored, stored) == []


def adamw(**options) -> torch.optim.AdamW:
    return torch.optim.AdamW([torch.nn.Parameter(torch.ones(2))], **options)


def test_options_of_the_recipe_replace_the_restored_ones():
    restored, wanted = adamw(lr=0.1, weight_decay=0.01), adamw(lr=0.2, weight_decay=0.05)
    schedules = [LambdaLR(optimizer, lambda step: 1 / (1 + step)) for optimizer in (restored, wanted)]
    restored.step()
    schedules[0].step()  # at half of the peak
    said = set_options(restored, wanted) + set_schedule(*schedules, wanted)
    assert said == ["lr is 0.2, the checkpoint had 0.1", "weight_decay is 0.05, the checkpoint had 0.01"]
    assert restored.param_groups[0]["lr"] == pytest.approx(0.1)
    assert restored.param_groups[0]["weight_decay"] == 0.05
    restored.step()
    schedules[0].step()
    assert restored.param_groups[0]["lr"] == pytest.approx(0.2 / 3)
    assert set_options(restored, wanted) == []


def test_a_schedule_of_the_recipe_replaces_the_restored_one():
    optimizer, other = adamw(lr=0.1), adamw(lr=0.1)
    restored, wanted = StepLR(optimizer, 20, 0.99), StepLR(other, 5, 0.99)
    assert set_schedule(restored, wanted, other) == ["step_size is 5, the checkpoint had 20"]
    assert restored.step_size == 5


def test_weights_of_other_shapes_are_named_where_no_setting_tells():
    first, second = torch.nn.Linear(2, 3), torch.nn.Linear(2, 4)
    with pytest.raises(RuntimeError) as refused:
        second.load_state_dict(first.state_dict())
    assert "weight has the shape [3, 2] in it and [4, 2] here" in str(other_sizes(refused.value, []))
    assert other_sizes(RuntimeError("out of memory"), []) is None


def test_what_a_run_computed_in_is_kept_unless_it_would_be_emulated(monkeypatch):
    stored = {"trainer": {"precision": "bf16-mixed"}, "memory_format": "contiguous"}
    cpu = torch.device("cpu")
    monkeypatch.setattr(run, "has_bfloat16_units", lambda device: True)
    assert run.as_before(stored, cpu) == Precision("bf16-mixed", "contiguous")
    monkeypatch.setattr(run, "has_bfloat16_units", lambda device: False)
    assert run.as_before(stored, cpu) is None
    assert run.as_before({"trainer": {"precision": "32-true"}}, cpu) == Precision("32-true", "channels_last")
    assert run.as_before({}, cpu) is None
