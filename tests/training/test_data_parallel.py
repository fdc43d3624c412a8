"""Two processes take the steps that one takes with all their rows."""

import copy
import os
import socket
import subprocess
import sys
from pathlib import Path

import jsonargparse
import pytest
import tiny
import tiny_controller
import tiny_data
import torch
import yaml
from torch import nn

from tsjepa import cli
from tsjepa.models import Encoder, entries
from tsjepa.training.norm import WholeBatchNorm, normalise, norms

STEPS = 3  # rounding grows with the steps: the background is of one colour, and its activations change sign together
CLOSE = 1e-3  # relative
HERE = Path(__file__).parent
# Adam divides by a gradient's size: this eps keeps the last digit of a gradient that is almost zero from counting
ADAM = {"class_path": "torch.optim.AdamW", "init_args": {"lr": 3e-3, "weight_decay": 0.1, "eps": 1e-4}}
SGD = {"class_path": "torch.optim.SGD", "init_args": {"lr": 0.01, "momentum": 0.9}}


def recipes() -> dict[str, dict]:
    """TS-JEPA, whose encoder has batch normalisation, with two optimizers, and the semantic actor with AdamW."""
    jepa, actor = (tiny.shrink(tiny.load(f"recipes/{name}.yaml")) for name in ("jepa", "actor"))
    actor["model"]["init_args"]["pretrained"] = "entry"
    fits = {"actor": actor}
    for name, optimizer in (("sgd", SGD), ("adam", ADAM)):
        fits[name] = copy.deepcopy(jepa)
        fits[name]["model"]["init_args"]["optimizer"] = optimizer
        fits[name]["data"]["init_args"]["frames_per_batch"] = 64
    for fit in fits.values():
        fit["data"]["init_args"]["path"] = "data"
        fit["trainer"] |= {"precision": "32-true", "max_epochs": -1, "max_steps": STEPS, "limit_val_batches": 0}
        fit["trainer"] |= {"accelerator": "cpu", "enable_checkpointing": False, "logger": False}
    return fits


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder in which one process, and then two, have taken the steps of each recipe; the working directory."""
    home = tmp_path_factory.mktemp("parallel")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        patch.syspath_prepend(str(HERE))
        # the callback is no part of the package, and this process has forbidden those by now
        patch.setitem(jsonargparse._common.parsing_settings, "import_path_verdicts", {})
        tiny_data.write(home / "data", slots=32, actor_plain=2, **tiny_data.SPLITS)
        entries.save(tiny_controller.tiny(), home / "entry")
        for name, recipe in recipes().items():
            for processes in (1, 2):
                run = f"{name}-{processes}"
                writing = {"class_path": "write_steps.WriteSteps", "init_args": {"folder": run}}
                recipe["trainer"]["callbacks"] = [writing]
                recipe["trainer"] |= {"devices": processes, "strategy": "ddp" if processes > 1 else "auto"}
                recipe["trainer"]["default_root_dir"] = f"runs/{run}"
                (home / f"{run}.yaml").write_text(yaml.safe_dump(recipe))
            assert cli.main(["fit", "--config", f"{name}-1.yaml", "--trust"]) == 0
        together([f"{name}-2.yaml" for name in recipes()])
        yield home


def together(recipes: list[str]) -> None:
    """Two processes that fit each recipe with each other."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    meet = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": "2", "NODE_RANK": "0"}
    environment = os.environ | meet | {"PYTHONPATH": os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])}
    processes = [
        subprocess.Popen(
            [sys.executable, HERE / "one_of_two.py", *recipes],
            env=environment | {"LOCAL_RANK": str(rank)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for rank in range(2)
    ]
    said = [process.communicate(timeout=300)[0] for process in processes]
    assert [process.returncode for process in processes] == [0, 0], "\n".join(said)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sgd", "adam", "actor"])
def test_two_processes_take_the_steps_of_one(home, name):
    one, two = (
        {path.stem: torch.load(path) for path in (home / f"{name}-{processes}").iterdir()} for processes in (1, 2)
    )
    assert set(one) == set(two) == {"start", "weights", *(f"gradients{step}" for step in range(STEPS))}
    for step in range(STEPS):
        ours, theirs = one[f"gradients{step}"], two[f"gradients{step}"]
        assert ours.keys() == theirs.keys()
        assert {key for key in ours if distance(ours[key], theirs[key]) > CLOSE * ours[key].norm()} == set()
    start, end = one["start"], one["weights"]
    moved = {key for key in start if not torch.equal(start[key], end[key]) and not start[key].isnan().any()}
    off = {key: distance(two["weights"][key], end[key]) / distance(start[key], end[key]) for key in moved}
    assert {key for key in moved if off[key] > CLOSE} == set()
    assert any(key.endswith("running_var") for key in moved) == (name != "actor")
    assert any("actor" in key if name == "actor" else "encoder" in key for key in moved)


def distance(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    """Euclidean, of two tensors of any kind of numbers."""
    return (one.double() - other.double()).norm()


@pytest.mark.parametrize("norm", [nn.BatchNorm2d(3), nn.BatchNorm2d(3, affine=False, momentum=None)])
def test_alone_it_is_torchs_batch_normalisation(norm):
    """In one process, values, gradients and running statistics are those of torch's own layer."""
    own, torchs = copy.deepcopy(norm), copy.deepcopy(norm)
    batches = 2 + 3 * torch.randn(2, 5, 3, 4, 2, generator=torch.Generator().manual_seed(0))
    gradients = []
    for layer, forward in ((own, lambda values: normalise(own, values)), (torchs, torchs)):
        rows = batches.clone().requires_grad_()
        made = torch.stack([forward(batch) for batch in rows])
        (made * batches.roll(1, 1)).sum().backward()
        gradients.append((made.detach(), rows.grad, layer.state_dict()))
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-4, atol=1e-5)
    own.eval()
    assert torch.equal(normalise(own, batches[0]), own(batches[0]))


def test_it_is_taken_off_again_and_leaves_names_and_kinds():
    encoder, sync = Encoder(widths=(4, 8, 8), embedding_dim=16), WholeBatchNorm()
    before = {name: type(part) for name, part in encoder.named_modules()}
    names = list(encoder.state_dict())
    sync.apply(encoder)
    assert all("forward" in vars(part) for part in norms(encoder)) and norms(encoder)
    sync.revert(encoder)
    assert not any("forward" in vars(part) for part in norms(encoder))
    assert {name: type(part) for name, part in encoder.named_modules()} == before
    assert list(encoder.state_dict()) == names
