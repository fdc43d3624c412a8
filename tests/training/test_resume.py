"""A fit that is resumed ends bit for bit where an undisturbed one ends; tests/faults/kills.py kills it first."""

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
import tiny
import torch
from safetensors.torch import load_file

from tsjepa import cli
from tsjepa.training.resume import AtomicCheckpointIO, ContinuedCSVLogger, FreshLog

pytestmark = pytest.mark.slow  # every test starts a process, trains or closes loops

EPOCHS = 6
# Every second epoch is validated, because a checkpoint after a validation restores other counters than one without.
CHANGES = {"max_epochs": EPOCHS, "check_val_every_n_epoch": 2}
CASES = {
    "recipes/jepa.yaml": {},
    # dropout, whose draws have to be repeated
    "recipes/actor.yaml": {"dropout": 0.2},
    # batches that are drawn anew by epoch and step
    "recipes/observer.yaml": {},
    # a learning rate that falls after every epoch
    "recipes/paper/jepa.yaml": {"step_size": 1, "gamma": 0.5},
}
BEFORE = {"recipes/actor.yaml": "recipes/jepa.yaml", "recipes/observer.yaml": "recipes/actor.yaml"}
STATE = ("state_dict", "optimizer_states", "lr_schedulers", "global_step", "epoch")


def keep_every_checkpoint(recipe: dict) -> dict:
    """With a checkpoint of each epoch beside the last one's."""
    options = {"dirpath": f"{recipe['trainer']['default_root_dir']}/every", "save_top_k": -1}
    # another mode, because Lightning wants different ones
    options |= {"every_n_epochs": 1, "save_on_train_epoch_end": True, "mode": "max"}
    every = {"class_path": "lightning.pytorch.callbacks.ModelCheckpoint", "init_args": options}
    recipe["trainer"]["callbacks"] = [*recipe["trainer"].get("callbacks", []), every]
    return recipe


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Runs a recipe undisturbed once and gives the folder of its run."""
    folder = tmp_path_factory.mktemp("resume")
    for name in tiny.NAMES:
        recipe = tiny.shrink(tiny.load(name))
        if name in CASES:
            recipe = keep_every_checkpoint(tiny.replace(recipe, CHANGES | CASES[name]))
            recipe["trainer"] |= CHANGES
        tiny.write(folder, name, recipe)
    done = {}

    def once(name: str) -> Path:
        if name not in done:
            path = Path(tiny.exported(tiny.merged(name))).parent
            before = BEFORE.get(name)
            if before and not Path(tiny.exported(tiny.merged(before))).exists():
                shutil.copytree(once(before) / "model", tiny.exported(tiny.merged(before)))
            assert cli.main(tiny.command_of(name)) == 0
            done[name] = path.rename(path.with_name(path.name + "-undisturbed"))
        return done[name]

    before = Path.cwd()
    os.chdir(folder)
    yield once
    os.chdir(before)


def differences(first, second, path: str = "") -> list[str]:
    """Where two checkpoints differ."""
    if isinstance(first, dict):
        keys = set(first) | set(second)
        return [p for key in keys for p in differences(first.get(key), second.get(key), f"{path}/{key}")]
    if isinstance(first, (list, tuple)):
        return [
            p
            for index, pair in enumerate(zip(first, second, strict=True))
            for p in differences(*pair, f"{path}/{index}")
        ]
    if isinstance(first, torch.Tensor):
        # ranges of a codec that nobody has fitted are NaN on both sides
        same = first.shape == second.shape and torch.allclose(first, second, rtol=0, atol=0, equal_nan=True)
        return [] if same else [path]
    return [] if first == second else [path]


def assert_same(undisturbed: Path, resumed: Path) -> None:
    """Checkpoints, exported models and logs are equal, to the bit."""
    first, second = (
        torch.load(path / "checkpoints" / "last.ckpt", weights_only=False) for path in (undisturbed, resumed)
    )
    assert differences({key: first[key] for key in STATE}, {key: second[key] for key in STATE}) == []
    first, second = (load_file(path / "model" / "model.safetensors") for path in (undisturbed, resumed))
    assert differences(first, second) == []
    assert (resumed / "metrics.csv").read_text() == (undisturbed / "metrics.csv").read_text()


@pytest.mark.parametrize("epoch", [0, 1, EPOCHS - 1])
@pytest.mark.parametrize("name", CASES)
def test_resumed_from_any_epoch_it_is_bit_identical(home, name, epoch):
    """After an epoch without and one with a validation, and after the last one, where only the export is left."""
    undisturbed = home(name)
    folder = Path(tiny.exported(tiny.merged(name))).parent
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copy(undisturbed / "metrics.csv", folder)
    (checkpoint,) = (undisturbed / "every").glob(f"epoch={epoch}-*.ckpt")
    (folder / "checkpoints").mkdir()
    shutil.copy(checkpoint, folder / "checkpoints" / "last.ckpt")
    assert cli.main([*tiny.command_of(name), "--ckpt_path", "last"]) == 0
    assert_same(undisturbed, folder)


def test_a_kill_while_a_checkpoint_is_written_leaves_the_one_before(tmp_path, monkeypatch):
    path = tmp_path / "checkpoints" / "last.ckpt"
    AtomicCheckpointIO().save_checkpoint({"step": 1}, path)

    def half(checkpoint, file):
        file.write(b"half")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(torch, "save", half)
        with pytest.raises(KeyboardInterrupt):
            AtomicCheckpointIO().save_checkpoint({"step": 2}, path)
    assert torch.load(path) == {"step": 1}
    AtomicCheckpointIO().save_checkpoint({"step": 3}, path)
    assert torch.load(path) == {"step": 3}
    assert [file.name for file in path.parent.iterdir()] == ["last.ckpt"]


def logged(folder: Path, *rows: tuple[int, dict]) -> str:
    logger = ContinuedCSVLogger(folder, name="", version="run")
    for step, metrics in rows:
        logger.log_metrics(metrics, step)
    logger.save()
    return (folder / "run" / "metrics.csv").read_text()


def test_a_resumed_log_goes_on_where_the_checkpoint_was(tmp_path):
    logged(tmp_path, (0, {"loss": 3.0}), (1, {"loss": 2.0}), (2, {"loss": 99.0}))
    assert logged(tmp_path, (2, {"loss": 1.0, "rank": 5.0})) == "loss,rank,step\n3.0,,0\n2.0,,1\n1.0,5.0,2\n"


def test_a_fresh_log_starts_anew(tmp_path):
    logged(tmp_path, (0, {"loss": 3.0}), (1, {"loss": 2.0}))
    assert logged(tmp_path, (0, {"loss": 1.0})) == "loss,step\n1.0,0\n"


@pytest.mark.parametrize(
    ("log", "kept"),
    [
        ("loss,rank,step\n3.0,1.0,0\n2.0,1.0,1\n1.0,1", "3.0,1.0,0\n2.0,1.0,1\n"),
        ("loss,rank,step\n3.0,1.0,0\n2.0,1.0\n", "3.0,1.0,0\n"),
        # another line was written on behind the one that was cut
        ("loss,rank,step\n3.0,1.0,0\n2.0,11.0,1.0,2\n", "3.0,1.0,0\n"),
        ("loss,rank,step\n3.0,1.0,0\n2.0,1.0,1.5\n", "3.0,1.0,0\n"),
        # cut within the number, which would be another step
        ("loss,rank,step\n3.0,1.0,0\n2.0,1.0,1", "3.0,1.0,0\n"),
        ("loss,rank,step", ""),
        ("loss,ra\n", ""),
        ("", ""),
    ],
)
def test_lines_of_a_log_that_were_cut_are_left_out(tmp_path, log, kept):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "metrics.csv").write_text(log)
    assert logged(tmp_path, (9, {"loss": 0.5, "rank": 2.0})) == f"loss,rank,step\n{kept}0.5,2.0,9\n"


def test_a_log_whose_lines_lack_a_later_column_goes_on(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "metrics.csv").write_text("loss,step,train\n3.0,0,0.1\n2.0,1\n")
    assert logged(tmp_path, (2, {"loss": 0.5})) == "loss,step,train\n3.0,0,0.1\n0.5,2,\n"


@pytest.mark.parametrize(
    ("checkpoint", "expected"), [(None, "loss,step\n1.0,9\n"), ("last.ckpt", "loss,step\n3.0,0\n2.0,1\n1.0,9\n")]
)
def test_only_a_fit_that_goes_on_from_a_checkpoint_keeps_the_rows_before_its_first(
    tmp_path, checkpoint, expected, capsys
):
    logged(tmp_path, (0, {"loss": 3.0}), (1, {"loss": 2.0}))
    logger = ContinuedCSVLogger(tmp_path, name="", version="run")
    trainer = SimpleNamespace(ckpt_path=checkpoint, is_global_zero=True, loggers=[logger], default_root_dir="runs/one")
    FreshLog("last").on_train_start(trainer, None)
    assert ("runs/one has no checkpoint to go on from" in capsys.readouterr().out) == (checkpoint is None)
    logger.log_metrics({"loss": 1.0}, 9)
    logger.save()
    assert (tmp_path / "run" / "metrics.csv").read_text() == expected
