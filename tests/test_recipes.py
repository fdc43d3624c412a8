"""Every recipe runs by the command that its head names, and so do the commands around a fit, on tiny data."""

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest
import tiny
import torch

import tsjepa
from tsjepa import cli
from tsjepa.data.storage import read_metadata
from tsjepa.data.writing import write_data_set
from tsjepa.support.spec import PlantSpec

pytestmark = pytest.mark.slow  # every test starts a process, trains or closes loops

LOADED = {name: tiny.merged(name) for name in tiny.NAMES}
PRODUCERS = {tiny.exported(recipe): name for name, recipe in LOADED.items() if tiny.exported(recipe)}
FITS = ("recipes/jepa.yaml", "recipes/actor.yaml", "recipes/supervised.yaml", "recipes/autoencoder.yaml")
# of these a checkpoint holds what makes commands; an autoencoder's law follows when the fit ends
COMMANDING_FITS = ("recipes/actor.yaml", "recipes/supervised.yaml")

# what no finish changes of that which a fit trains
LEARNT = {
    "recipes/jepa.yaml": "encoder.stages.",
    "recipes/actor.yaml": "model.actor.",
    "recipes/observer.yaml": "model.observer.",
    "recipes/supervised.yaml": "model.actor.",
    "recipes/autoencoder.yaml": "model.encoder.",
}


def names(command: str) -> list[str]:
    return [name for name in tiny.NAMES if tiny.command_of(name)[0] == command]


def recorded(folder: Path) -> None:
    """A data set as ``tsjepa import`` leaves it: 44 commands, of which one never changes, and no validation split."""
    draw, frames, numbers = np.random.default_rng(0), 37, 44
    spec = PlantSpec(
        action_low=(-1.0,) * numbers, action_high=(1.0,) * numbers, slot=0.05, frame=(64, 64),
        state_names=tuple(f"motor_{number}" for number in range(numbers)), state_scale=(1.0,) * numbers,
    )  # fmt: skip
    splits = {
        name: [
            {
                "pixels": draw.integers(0, 256, (frames, 64, 64, 3)).astype(np.uint8),
                "action": (draw.uniform(-1, 1, (frames, numbers)) * (np.arange(numbers) > 0)).astype(np.float32),
                "state": draw.uniform(-1, 1, (frames, numbers)).astype(np.float32),
            }
            for _ in range(2)
        ]
        for name in ("train", "test")
    }
    metadata = {
        "splits": {name: {"episodes": 2, "slots": frames - 1} for name in splits},
        "slots": frames - 1,
        "spec": spec.to_dict(),
    }
    write_data_set(folder, splits, metadata)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Runs a recipe once, after those whose models it reads, in a folder that holds nothing but the tiny recipes."""
    folder = tmp_path_factory.mktemp("work")
    for name in tiny.NAMES:
        tiny.write(folder, name, tiny.shrink(tiny.load(name)))
    recorded(folder / "data" / "arm")
    done = set()

    def once(name: str) -> dict:
        if name not in done:
            for model in tiny.strings(LOADED[name]) & (set(PRODUCERS) - {tiny.exported(LOADED[name])}):
                once(PRODUCERS[model])
            if trace := LOADED[name].get("radio", {}).get("trace"):
                delays = ["--radio.delay", '{"shift": 5, "mean_excess": 10}']
                assert cli.main(["trace", "simulate", trace, "--num_devices", "3", "--slots", "50", *delays]) == 0
            # a fit collects its data set by itself, so a data recipe has to write elsewhere; short loops take less time
            loop = ["--slots", "60" if "slots" in LOADED[name] else "40"]  # a set-point changes after 50
            fleet = [] if "search_over" in LOADED[name] else ["--slots", "60"]
            options_of = {"collect": ["--path", f"again/{name}"], "evaluate": loop, "simulate": fleet}
            options = options_of.get(tiny.command_of(name)[0], [])
            assert cli.main([*tiny.command_of(name), *options]) == 0
            done.add(name)
        return LOADED[name]

    before = Path.cwd()
    os.chdir(folder)
    yield once
    os.chdir(before)


def test_every_recipe_is_run_below():
    figures = names("figures")  # in tests/evaluation/figures; watch in tests/watch
    assert set(
        names("fit") + names("collect") + names("evaluate") + names("simulate") + names("watch") + figures
    ) == set(tiny.NAMES)


@pytest.mark.parametrize("name", names("fit"))
def test_a_fit_leaves_a_model_that_loads_a_checkpoint_and_a_log(run, name):
    recipe = run(name)
    model = tsjepa.load(tiny.exported(recipe))
    data = recipe["data"]["init_args"]["path"]
    assert model.embedding_dim == tiny.SIZES["embedding_dim"]
    assert model.spec.slot == read_metadata(data)["spec"]["slot"]
    home = Path(tiny.exported(recipe)).parent
    assert (home / "checkpoints" / "last.ckpt").is_file()
    if recipe["trainer"].get("limit_val_batches") != 0:
        with (home / "metrics.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert any(key.startswith("val/") and row[key] for row in rows for key in row)
    assert not list(home.rglob("*.partial"))


@pytest.mark.parametrize("name", LEARNT)
def test_a_fit_takes_every_step_of_its_schedule_and_exports_the_last_weights(run, name):
    """Nothing ends it early: the schedule has cooled down, which is what makes the last weights the ones to keep."""
    home = Path(tiny.exported(run(name))).parent
    last, model = torch.load(home / "checkpoints" / "last.ckpt"), tsjepa.load(home / "model")
    assert last["epoch"] + 1 == tiny.SIZES["max_epochs"]
    assert not any("EarlyStopping" in callback for callback in last["callbacks"])
    assert all(abs(rate) < 1e-9 for schedule in last["lr_schedulers"] for rate in schedule["_last_lr"])
    learnt = {key: value for key, value in last["state_dict"].items() if key.startswith(LEARNT[name])}
    assert learnt
    assert all(torch.equal(model.state_dict()[key.removeprefix("model.")], learnt[key]) for key in learnt)


@pytest.mark.parametrize("name", names("collect"))
def test_a_collection_is_whole_and_a_fit_that_finds_none_makes_the_same(run, name):
    recipe = run(name)
    metadata = read_metadata(f"again/{name}")
    assert set(metadata["splits"]) == set(recipe["splits"])
    fits = [fit for fit in names("fit") if LOADED[fit]["data"]["init_args"]["path"] == recipe["path"]]
    if not fits:  # it is collected for a training that tsjepa zoo train makes of other recipes
        return
    run(fits[0])
    assert read_metadata(recipe["path"])["sha256"] == metadata["sha256"]


@pytest.mark.parametrize("name", names("evaluate"))
def test_an_evaluation_writes_table_plot_and_film(run, name):
    recipe = run(name)
    output = Path(recipe["output"])
    result = json.loads((output / "evaluation.json").read_text())
    rows = {(row["controller"], row["update_every"]) for row in result["closed_loop"]}
    assert {("TS-JEPA", 1), ("TS-JEPA", 5), ("TS-JEPA", "once"), ("expert, zero", 5)} <= rows
    assert all(0 <= row["failures"] <= row["starts"] == 12 for row in result["closed_loop"])
    assert 0 < result["open_loop"]["command_nmae"] < 1
    pictures = ("score.png", "horizon.png", "inside.png", "loop.mp4")
    assert all((output / picture).stat().st_size > 1000 for picture in pictures)


@pytest.mark.parametrize("name", names("simulate"))
def test_a_simulation_writes_its_results(run, name):
    recipe = run(name)
    assert any(path.stat().st_size for path in Path(recipe["output"]).iterdir())


@pytest.mark.parametrize("name", FITS)
def test_validate_and_test_print_their_figures_and_leave_the_fit_alone(run, name, capsys):
    home = Path(tiny.exported(run(name))).parent
    before = {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}
    for command, prefix in (("validate", "val/"), ("test", "test/")):
        assert cli.main([command, "--config", f"{home}/config.yaml", "--ckpt_path", "last"]) == 0
        assert prefix in capsys.readouterr().out
    assert before == {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", FITS)
def test_predict_writes_arrays_of_the_test_split(run, name):
    home = Path(tiny.exported(run(name))).parent
    assert cli.main(["predict", *tiny.command_of(name)[1:], "--ckpt_path", "last"]) == 0
    with np.load(home / "predictions.npz") as arrays:
        assert arrays["embedding"].shape[-1] == tiny.SIZES["embedding_dim"]
        assert arrays["embedding"].shape[:-1] == arrays["state"].shape[:-1]
        assert np.allclose(np.linalg.norm(arrays["embedding"], axis=-1), 1, atol=1e-5)
        assert name not in COMMANDING_FITS or arrays["command"].shape == arrays["expert_action"].shape
