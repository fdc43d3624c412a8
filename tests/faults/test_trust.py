"""Nothing from a file is unpickled, imported or called unless the user wrote --trust."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import jsonargparse
import pytest
import torch
import yaml
from conftest import DATA, RECIPE, RUN
from tensordict import TensorDict

from tsjepa.data.storage import METADATA, file_sizes, open_split
from tsjepa.training.resume import AtomicCheckpointIO

POPEN = {"class_path": "subprocess.Popen", "init_args": {"args": ["touch", "pwned"]}}
CALLBACKS = "lightning.pytorch.callbacks"


class Bomb:
    """Unpickling it touches a file."""

    def __reduce__(self):
        return os.system, ("touch pwned",)


def break_in(path: str, value) -> dict:
    """A recipe in which ``value`` stands where the dotted ``path`` says."""
    recipe = yaml.safe_load(Path(RECIPE).read_text())
    *parents, last = path.split(".")
    place = recipe
    for key in parents:
        place = place[key]
    place[last] = value
    return recipe


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("model", {"class_path": "os.system", "init_args": {"command": "touch pwned"}}),
        ("model", POPEN),
        ("data", POPEN),
        ("model.init_args.optimizer", "os.system"),
        ("model.init_args.optimizer", POPEN),
        ("model.init_args.encoder", POPEN),
        ("trainer.callbacks", [POPEN]),
        ("trainer.callbacks", [{"class_path": f"{CALLBACKS}.LambdaCallback", "init_args": {"setup": "os.system"}}]),
        ("trainer.callbacks", [{"class_path": f"{CALLBACKS}.LambdaCallback", "init_args": {"setup": POPEN}}]),
        # an option of any type
        (
            "trainer.strategy",
            {"class_path": "lightning.pytorch.strategies.DDPStrategy", "init_args": {"ddp_comm_state": POPEN}},
        ),
    ],
)
def test_a_recipe_cannot_name_what_is_not_a_part_of_a_model(home, command, path, value):
    (home / "evil.yaml").write_text(yaml.safe_dump(break_in(path, value)))
    status, complaint = command("fit", "--config", "evil.yaml")
    assert status == 2
    assert "is not of tsjepa, lightning, torch" in complaint and "--trust" in complaint
    assert not (home / "pwned").exists()


@pytest.mark.parametrize("tag", ["object/apply:os.system ['touch pwned']", "name:os.system", "module:this"])
def test_a_recipe_cannot_use_the_tags_of_python(home, command, tag):
    (home / "evil.yaml").write_text(f"model: !!python/{tag}\n")
    for name in ("fit", "collect"):
        status, complaint = command(name, "--config", "evil.yaml")
        assert status == 2 and "constructor" in complaint
    assert not (home / "pwned").exists()


def test_a_module_that_a_recipe_names_is_not_even_imported(home, command, monkeypatch):
    (home / "mine.py").write_text("from pathlib import Path\nPath('pwned').touch()\n")
    monkeypatch.syspath_prepend(str(home))
    status, complaint = command("fit", "--config", RECIPE, "--model", "mine.Model")
    assert status == 2 and complaint.startswith("tsjepa fit: mine.Model is not of tsjepa")
    # nor one that a value makes look as if it had been tried
    value = json.dumps({"class_path": "Problem with given class_path 'mine.Model': No module named 'x'"})
    status, complaint = command("simulate", "--plant", value)
    assert status == 2 and "mine.Model" in complaint
    assert not (home / "pwned").exists()


def test_with_trust_a_recipe_may_name_a_class_of_ones_own(home, command, monkeypatch):
    (home / "own_part.py").write_text("import lightning\nclass Own(lightning.Callback):\n    pass\n")
    monkeypatch.syspath_prepend(str(home))
    # the restriction lasts as long as a process, and this one has run other commands
    monkeypatch.setitem(jsonargparse._common.parsing_settings, "import_path_verdicts", {})
    recipe = yaml.safe_load(Path(RECIPE).read_text())
    recipe["trainer"]["callbacks"].append({"class_path": "own_part.Own"})
    (home / "own.yaml").write_text(yaml.safe_dump(recipe))
    assert command("validate", "--config", "own.yaml", "--trust")[0] == 0


@pytest.mark.parametrize("name", ["inspect", "import"])
def test_a_reader_that_a_recipe_names_is_not_even_imported_and_one_that_is_typed_is(
    tmp_path, command, monkeypatch, name
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    Path("own_readers.py").write_text("from pathlib import Path\nPath('imported').touch()\n")
    Path("evil.yaml").write_text("reader: own_readers.Own\n")
    words = (name, ".", *(["set"] if name == "import" else []))
    status, complaint = command(*words, "--config", "evil.yaml")
    assert status == 2 and "The recipe names the reader own_readers.Own" in complaint and "--trust" in complaint
    assert command(*words, "--reader", "own_readers.Typed", "--config", "evil.yaml")[0] == 2  # the later one wins
    assert not Path("imported").exists()
    for own in (["--reader", "own_readers.Own"], ["--reader=own_readers.Own"], ["--config", "evil.yaml", "--trust"]):
        status, complaint = command(*words, *own)
        assert status == 2 and "The reader own_readers.Own cannot be imported" in complaint  # it has no such class
        Path("imported").unlink()
        sys.modules.pop("own_readers")


@pytest.mark.parametrize("name", ["fit", "validate", "test", "predict"])
def test_a_checkpoint_is_not_unpickled(home, command, name):
    path = home / RUN / "checkpoints" / "last.ckpt"
    torch.save({**torch.load(path), "hyper_parameters": Bomb()}, path)
    status, complaint = command(name, "--config", RECIPE, "--ckpt_path", str(path))
    assert status == 2
    assert "--trust" in complaint and str(path) in complaint
    assert not (home / "pwned").exists()


def test_a_recipe_cannot_ask_for_unpickling(home, command):
    (home / "evil.yaml").write_text(yaml.safe_dump({**break_in("seed_everything", 0), "weights_only": False}))
    status, complaint = command("validate", "--config", "evil.yaml", "--ckpt_path", "last")
    assert status == 2 and "--trust" in complaint


def test_with_trust_a_checkpoint_is_unpickled(home):
    path = home / "own.ckpt"
    torch.save({"own": Path("anything")}, path)
    assert AtomicCheckpointIO().load_checkpoint(path, weights_only=False) == {"own": Path("anything")}


def test_a_cut_checkpoint_is_named(home, command):
    path = home / RUN / "checkpoints" / "last.ckpt"
    path.write_bytes(path.read_bytes()[:-1000])
    status, complaint = command("fit", "--config", RECIPE, "--ckpt_path", str(path))
    assert status == 2 and f"{path} is damaged" in complaint


def test_a_data_set_is_not_unpickled(home):
    shutil.rmtree(home / DATA / "train")
    TensorDict({"action": torch.zeros(2, 3)}, [2, 3]).set_non_tensor("secret", Bomb()).memmap(home / DATA / "train")
    metadata = json.loads((home / DATA / METADATA).read_text())
    (home / DATA / METADATA).write_text(json.dumps({**metadata, "files": file_sizes(home / DATA)}))
    with pytest.raises(ValueError, match="split train cannot be read") as refused:
        open_split(home / DATA, "train")
    assert "pickle" in str(refused.value.__cause__)
    assert not (home / "pwned").exists()


@pytest.mark.slow
def test_without_being_asked_it_opens_no_connection(home):
    code = (
        "import socket, sys\n"
        "def refuse(event, arguments):\n"
        "    if event in ('socket.connect', 'socket.getaddrinfo', 'socket.bind'):\n"
        "        raise OSError(f'{event} {arguments}')\n"
        "sys.addaudithook(refuse)\n"
        "import tsjepa\n"
        "from tsjepa.cli import main\n"
        f"assert main(['fit', '--config', '{RECIPE}', '--trainer.max_epochs', '1']) == 0\n"
        f"assert tsjepa.load('{RUN}/model').act\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
