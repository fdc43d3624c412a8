"""A stranger's encoder, from the page that shows how to write one to an entry that controls a fleet."""

import json
import re
import sys
from pathlib import Path

import jsonargparse
import pytest
import tiny
import tiny_data
import torch

import tsjepa
from tsjepa import cli
from tsjepa.models import entries
from tsjepa.support import trust

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "write-an-encoder.md"
STEPS = {"max_epochs": -1, "max_steps": 3, "limit_val_batches": 0, "enable_checkpointing": False, "logger": False}
LOOPS = ["--slots=80", "--seeds=2", "--video=false"]


def block(language: str) -> str:
    """The page's first block of that language."""
    return re.search(rf"```{language}\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)[1]


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A working directory with the page's two files, the main job's recipes made tiny, and their data set."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    # this process may have forbidden classes of others, and must not trust them after this test
    monkeypatch.setitem(jsonargparse._common.parsing_settings, "import_path_verdicts", {})
    monkeypatch.setattr(trust, "_trusted", False)
    (tmp_path / "my_encoder.py").write_text(block("python"))
    (tmp_path / "my_encoder.yaml").write_text(block("yaml"))
    for name in ("recipes/jepa.yaml", "recipes/actor.yaml"):
        recipe = tiny.shrink(tiny.load(name))
        recipe["trainer"] |= STEPS
        recipe["data"]["init_args"]["path"] = "data"
        tiny.write(tmp_path, name, recipe)
    tiny_data.write(tmp_path / "data", slots=32, actor_plain=2, **tiny_data.SPLITS)
    yield tmp_path
    sys.modules.pop("my_encoder", None)


def run(*words: str) -> None:
    assert cli.main([*words, "--trust"]) == 0


@pytest.mark.slow
def test_it_trains_loads_is_exported_controls_a_fleet_and_is_deployed(home, capsys):
    run("fit", "--config", "recipes/jepa.yaml", "--config", "my_encoder.yaml")
    run("fit", "--config", "recipes/actor.yaml", "--model.init_args.pretrained", "runs/my-jepa/model")
    encoder, trained = (tsjepa.load(f"runs/{name}/model", trusted=True).encoder for name in ("my-jepa", "actor"))
    assert type(encoder).__name__ == "Thumbnail" and type(encoder).__module__ == "my_encoder"
    # centred when the fit ended, and frozen while the actor learnt
    assert trained.state_dict().keys() == encoder.state_dict().keys()
    assert all(torch.equal(value, trained.state_dict()[name]) for name, value in encoder.state_dict().items())
    run(
        "evaluate", "runs/actor/model", "--output=runs/actor/evaluation", "--starts_per_seed=6", "--periods=[1]", *LOOPS
    )
    run("export", "runs/actor", "mine", "--folder=zoo")
    run(
        "simulate",
        "--controller=zoo/mine",
        "--num_devices=6",
        "--radio.resource_blocks=6",
        "--schedulers=[round_robin]",
        "--output=fleet",
        *LOOPS,
    )
    fleet = json.loads((home / "fleet" / "fleet.json").read_text())
    assert fleet["model_sha256"] == entries.fingerprint(home / "zoo" / "mine")
    (row,) = fleet["schedulers"]
    assert row["bits_per_device_and_slot"] == 32 * 16
    run("deploy", "zoo/mine", "graphs", "--format=torch_export")
    graph = torch.export.load(home / "graphs" / "device.pt2").module()
    frames = torch.randint(0, 256, (3, 2, 64, 128, 3), dtype=torch.uint8)
    assert graph(frames).shape == (3, 16)  # int8


@pytest.mark.slow
def test_without_trust_it_is_refused_in_one_sentence(home, capsys):
    with pytest.raises(SystemExit) as status:
        cli.main(["fit", "--config", "recipes/jepa.yaml", "--config", "my_encoder.yaml"])
    assert status.value.code == 2
    assert "my_encoder" in capsys.readouterr().err
    assert not (home / "runs").exists()
