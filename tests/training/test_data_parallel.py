"""Two processes take the steps that one takes with all their windows."""

import copy
import os
import subprocess
import sys
from pathlib import Path

import jsonargparse
import pytest
import tiny
import torch
import yaml
from torch.nn.modules.batchnorm import _BatchNorm

from tsjepa import cli
from tsjepa.data.augmentation import Augmentation
from tsjepa.models import Encoder, Predictor
from tsjepa.training.jepa import TSJEPA

pytestmark = pytest.mark.slow  # every test starts a process, trains or closes loops

STEPS = 20
JEPA, DATA = "recipes/jepa.yaml", "recipes/data.yaml"


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A folder with a recipe of twenty steps in 32 bits, and its data set, as the working directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    # the callback is no part of the package, and this process has forbidden those by now
    monkeypatch.setitem(jsonargparse._common.parsing_settings, "import_path_verdicts", {})
    recipe = tiny.shrink(tiny.load(JEPA))
    # Adam would blow up the last digit of a gradient that is almost zero
    recipe["model"]["init_args"]["optimizer"] = {
        "class_path": "torch.optim.SGD",
        "init_args": {"lr": 0.01, "momentum": 0.9},
    }
    recipe["trainer"] |= {"precision": "32-true", "max_epochs": -1, "max_steps": STEPS, "limit_val_batches": 0}
    recipe["trainer"] |= {"accelerator": "cpu", "callbacks": [], "enable_checkpointing": False, "logger": False}
    for name, processes in (("one", 1), ("two", 2)):
        recipe["trainer"]["callbacks"] = [{"class_path": "frozen_norm.FrozenNorm", "init_args": {"folder": name}}]
        recipe["trainer"] |= {"devices": processes, "strategy": "ddp" if processes > 1 else "auto"}
        recipe["trainer"]["default_root_dir"] = f"runs/{name}"
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(recipe))
    tiny.write(tmp_path, DATA, tiny.shrink(tiny.load(DATA)))
    return tmp_path


def test_two_processes_take_the_steps_of_one(home):
    assert cli.main(["fit", "--config", "one.yaml", "--trust"]) == 0
    subprocess.run(
        [sys.executable, "-m", "tsjepa.cli", "fit", "--config", "two.yaml", "--trust"],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent)},
        check=True,
        capture_output=True,
    )
    files = sorted(path.name for path in (home / "one").iterdir())
    assert files == sorted(path.name for path in (home / "two").iterdir())
    assert len(files) == STEPS + 1
    for name in files:
        one, two = (torch.load(home / folder / name) for folder in ("one", "two"))
        torch.testing.assert_close(two, one, rtol=1e-5, atol=1e-5)


def test_normalisation_over_all_processes_keeps_the_names_of_the_weights():
    """--trainer.sync_batchnorm true, for GPUs: checkpoints fit both."""
    module = TSJEPA(Encoder(widths=(4, 8, 8), embedding_dim=16), Predictor(16, 32), Augmentation())
    converted = torch.nn.SyncBatchNorm.convert_sync_batchnorm(copy.deepcopy(module))
    assert converted.state_dict().keys() == module.state_dict().keys()
    norms = [part for part in converted.modules() if isinstance(part, _BatchNorm)]
    assert norms and all(isinstance(part, torch.nn.SyncBatchNorm) for part in norms)
