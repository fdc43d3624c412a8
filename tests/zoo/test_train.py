"""``tsjepa zoo train``: every entry has its commands, a second start goes on, and a tiny one is made whole."""

import itertools
import json
import os
from pathlib import Path

import pytest
import tiny

import tsjepa
from tsjepa import cli
from tsjepa.models import entries
from tsjepa.zoo import train as train_module
from tsjepa.zoo.steps import ENTRIES, commands
from tsjepa.zoo.train import train

STEPS = ("jepa", "actor", "evaluate", "export")


def test_every_shipped_entry_has_a_recipe():
    assert set(entries.names()) <= set(ENTRIES)


@pytest.mark.parametrize("name", ENTRIES)
def test_the_commands_of_an_entry_follow_from_each_other(name):
    steps = commands(ENTRIES[name], "runs/zoo/x", name, 3)
    assert list(steps)[-2:] == ["evaluate", "export"]
    fits = [words for words in steps.values() if words[0] == "fit"]
    made = []
    for words in fits:
        options = dict(zip(words[1::2], words[2::2], strict=True))
        assert options["--seed_everything"] == "3"
        # the first starts from nothing, the next from the model that the one before has left
        assert options.get("--model.init_args.pretrained") == (made[-1] if made else None)
        made.append(options["--trainer.default_root_dir"] + "/model")
    assert steps["evaluate"][steps["evaluate"].index("--model") + 1] == made[-1]
    for words in steps.values():
        named = [word for flag, word in itertools.pairwise(words) if flag == "--config"]
        assert all((tiny.ROOT / recipe).is_file() for recipe in named)


def test_a_training_seed_has_a_folder_of_its_own_and_an_unknown_entry_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train_module, "run", refusing("jepa"))
    with pytest.raises(RuntimeError):
        train("tsjepa-cartpole-d16", 2)
    assert (tmp_path / "runs/zoo/tsjepa-cartpole-d16-seed2/steps.journal").is_file()
    with pytest.raises(ValueError, match="no recipe for 'absent': choose one of tsjepa-cartpole"):
        train("absent")


def refusing(what: str, log: list | None = None):
    """In place of a command's process: a fit leaves a checkpoint, and the one that writes ``what`` fails."""

    def run(words):
        root = dict(itertools.pairwise(words)).get("--trainer.default_root_dir")
        if log is not None:
            log.append(words)
        if root:
            (Path(root) / "checkpoints").mkdir(parents=True, exist_ok=True)
            (Path(root) / "checkpoints" / "last.ckpt").touch()
        if root and root.endswith(what):
            raise RuntimeError(what)
        return 7.0

    return run


def test_a_second_start_goes_on_where_the_first_was_broken_off(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train_module, "run", refusing("actor"))
    with pytest.raises(RuntimeError, match="actor"):
        train("tsjepa-cartpole-d16")
    ran = []
    monkeypatch.setattr(train_module, "run", refusing("nothing", ran))
    monkeypatch.setattr(train_module, "key_figures", lambda name: {"entry": name})
    monkeypatch.setattr(train_module, "table", lambda rows: f"{len(rows)} rows")
    train("tsjepa-cartpole-d16")
    assert [words[0] for words in ran] == ["fit", "evaluate", "export"]
    assert ran[0][-2:] == ["--ckpt_path", "last"] and "--ckpt_path" not in ran[1]
    said = ran[2][ran[2].index("--trained_with") + 1]
    assert "tsjepa zoo train tsjepa-cartpole-d16" in said and "jepa 7 s, actor 7 s, evaluate 7 s" in said
    assert "jepa: done before, in 7 s" in capsys.readouterr().out


@pytest.mark.slow
def test_one_command_makes_an_entry_with_its_card(tmp_path, monkeypatch, capfd):
    for name in tiny.NAMES:
        tiny.write(tmp_path, name, tiny.shrink(tiny.load(name)))
    monkeypatch.chdir(tmp_path)
    assert cli.main(["zoo", "train", "tsjepa-cartpole-d16"]) == 0
    folder = Path("runs/zoo/tsjepa-cartpole-d16/entry/tsjepa-cartpole-d16")
    model = tsjepa.load(str(folder))
    assert model.embedding_dim == 16
    assert "Made by `tsjepa zoo train tsjepa-cartpole-d16`" in (folder / "README.md").read_text()
    figures = json.loads((folder / "metrics.json").read_text())
    assert [Path(fit["data"]).name for fit in figures["training"]] == ["cartpole-large"] * 2
    printed = capfd.readouterr().out
    assert (
        "tsjepa fit --config recipes/jepa.yaml" in printed and f"cores of {figures['machine']['processor']}" in printed
    )
    before = {path: os.stat(path).st_mtime_ns for path in folder.iterdir()}
    assert cli.main(["zoo", "train", "tsjepa-cartpole-d16"]) == 0
    assert before == {path: os.stat(path).st_mtime_ns for path in folder.iterdir()}
