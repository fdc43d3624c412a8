"""``tsjepa fit`` chooses what it computes in, says so, and its finishes follow."""

import json

import pytest
import tiny
import tiny_data
import torch
import yaml

import tsjepa
from tsjepa import cli
from tsjepa.support.files import exclusive
from tsjepa.support.precision import Precision
from tsjepa.training import run
from tsjepa.training.callbacks import Pace, pace
from tsjepa.training.continuing import stored_settings
from tsjepa.training.finish import refine
from tsjepa.zoo.training_history import training_history

FINISH = "tsjepa.training.finish"
MORE = {
    f"{FINISH}.probe.FitProbe": {"steps": 2},
    f"{FINISH}.decoder.FitDecoder": {"steps": 2},
    f"{FINISH}.codec.FitCodec": {},
}


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A folder with the main recipe, tiny, which says nothing of precision and fits all that can be fitted."""
    monkeypatch.chdir(tmp_path)
    recipe = tiny.shrink(tiny.load("recipes/jepa.yaml"))
    del recipe["trainer"]["precision"]
    recipe["trainer"]["max_epochs"] = 1
    recipe["trainer"]["callbacks"] += [{"class_path": name, "init_args": options} for name, options in MORE.items()]
    tiny.write(tmp_path, "recipe.yaml", recipe)
    tiny_data.write(tmp_path / recipe["data"]["init_args"]["path"], slots=40, **tiny_data.SPLITS | {"train": 16})
    return tmp_path / "runs/jepa"


@pytest.fixture
def autocast(monkeypatch):
    """Whether each roll-out of the finish ran under autocast."""
    seen, rollout = [], refine.rollout

    def watched(*arguments):
        seen.append(torch.is_autocast_enabled("cpu"))
        return rollout(*arguments)

    monkeypatch.setattr(refine, "rollout", watched)
    return seen


@pytest.mark.slow
def test_a_fit_computes_in_what_the_machine_is_fastest_in_and_says_so(home, autocast, monkeypatch, capsys):
    monkeypatch.setattr(run, "choose", lambda encoder, device: Precision("bf16-mixed", "contiguous"))
    monkeypatch.setattr(Pace, "SKIPPED", 1)
    monkeypatch.setattr(Pace, "TIMED", 1)
    assert cli.main(["fit", "--config", "recipe.yaml"]) == 0
    said = capsys.readouterr().out
    assert "This fit computes in bf16-mixed, contiguous, on " in said
    assert " s a step, about " in said and ", then CentreEmbedding, RefinePredictor, FitProbe" in said
    config = yaml.safe_load((home / "config.yaml").read_text())
    assert (config["trainer"]["precision"], config["memory_format"]) == ("bf16-mixed", "contiguous")
    machine = json.loads((home / "model/metrics.json").read_text())["machine"]
    assert (machine["precision"], machine["memory_format"]) == ("bf16-mixed", "contiguous")
    assert {"processor", "flags"} <= machine.keys()
    assert autocast and all(autocast)
    # what the finishes fit is what is exported
    model = tsjepa.load(home / "model")
    assert model.decoder.fitted and model.code_low.isfinite().all() and model.probe.state_mean.abs().max() > 0


@pytest.mark.slow
def test_a_precision_that_is_given_holds_for_the_finishes_too(home, autocast, monkeypatch, capsys):
    monkeypatch.setattr(run, "choose", None)
    assert cli.main(["fit", "--config", "recipe.yaml", "--trainer.precision", "32-true"]) == 0
    assert "This fit computes in 32-true, channels_last, on " in capsys.readouterr().out
    assert autocast and not any(autocast)


@pytest.mark.slow
def test_the_folder_of_a_fit_is_its_own_and_holds_its_recipe_whatever_the_logger(home, capsys):
    logger = {"class_path": "lightning.pytorch.loggers.CSVLogger", "init_args": {"save_dir": "elsewhere"}}
    words = ["fit", "--config", "recipe.yaml", "--trainer.logger", json.dumps(logger)]
    with exclusive(home):
        assert cli.main(words) == 2
    assert "Another process is writing runs/jepa" in capsys.readouterr().err
    assert cli.main(words) == 0
    assert [path.name for path in home.parent.parent.glob("elsewhere/**/*.csv")] == ["metrics.csv"]
    config = yaml.safe_load((home / "config.yaml").read_text())
    assert config["trainer"]["logger"]["init_args"]["save_dir"] == "elsewhere"
    assert stored_settings(home) == config
    (fit,) = training_history(home / "model")
    assert fit["data"] == config["data"]["init_args"]["path"]


def settings(**changes):
    return run.Namespace(**{"accelerator": "auto", "devices": "auto", "num_nodes": 1, **changes})


def test_several_processes_decide_alike_without_a_measurement(monkeypatch):
    monkeypatch.setattr(run, "choose", lambda encoder, device: "measured")
    monkeypatch.setattr(run, "candidates", lambda device: ["likeliest"])
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    module = torch.nn.Module()
    assert run.decide(None, settings(), module) == "measured"
    assert run.decide(None, settings(devices=1), module) == "measured"
    assert run.decide(None, settings(devices=2), module) == "likeliest"
    assert run.decide(None, settings(num_nodes=2), module) == "likeliest"
    assert run.decide("given", settings(), module) == "given"


@pytest.mark.parametrize(
    ("seconds", "left", "text"),
    [
        (0.31, 1742, "0.31 s a step, about 9 min left for 1742 steps"),
        (0.05, 100, "0.05 s a step, about 5 s left for 100 steps"),
        (4.8, 3500, "4.8 s a step, about 4.7 h left for 3500 steps"),
        (0.31, float("inf"), "0.31 s a step"),
    ],
)
def test_the_pace_in_words(seconds, left, text):
    assert pace(seconds, left) == text


def test_no_recipe_fixes_the_precision():
    assert not [name for name in tiny.NAMES if "precision" in tiny.load(name).get("trainer", {})]
