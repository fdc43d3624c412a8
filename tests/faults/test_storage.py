"""Full disks, read-only folders, two processes in one folder, and data that is damaged or makes no sense."""

import contextlib
import errno
import json
import os
import re
import resource
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml
from conftest import ACTOR, DATA, DATA_RECIPE, RECIPE, RUN
from tensordict import TensorDict

from tsjepa.data.storage import METADATA, open_split, write_picture
from tsjepa.data.writing import write_data_set
from tsjepa.evaluation.films import count_frames, write_video
from tsjepa.models import entries
from tsjepa.support.files import exclusive, replace_folder, write_text
from tsjepa.support.journal import Journal
from tsjepa.training.resume import AtomicCheckpointIO

EXPORT = ("export", str(ACTOR), "tiny")


@pytest.fixture
def file_size_limit():
    """Lets no file grow beyond so many bytes, which is how a disk that is full answers; for every user."""

    @contextlib.contextmanager
    def limit(size: int) -> Iterator[None]:
        # no longer than the command: the file that pytest's own report goes to may be beyond it
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limit


@pytest.fixture
def mount():
    """Mounts a small file system over a folder, for root; a container may be forbidden to."""
    mounted = []

    def tmpfs(folder: Path, options: str) -> None:
        folder.mkdir(exist_ok=True)
        if subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], capture_output=True).returncode:
            pytest.skip("no right to mount a file system")
        mounted.append(folder)

    yield tmpfs
    for folder in mounted:
        subprocess.run(["umount", folder], check=True)


@pytest.fixture
def small_disk(tmp_path, mount):
    """A folder on a file system of 2 MB."""
    mount(tmp_path / "disk", "size=2m")
    return tmp_path / "disk"


@pytest.fixture
def seal(mount):
    """Makes a folder read-only, also for root."""
    sealed = []

    def make_read_only(folder: Path) -> None:
        if os.geteuid() == 0:
            mount(folder, "ro")
        else:
            folder.chmod(0o500)
            sealed.append(folder)

    yield make_read_only
    for folder in sealed:
        folder.chmod(0o700)


@pytest.fixture
def evaluation(home):
    """An evaluation of the model that the tiny fit left."""
    figures = {"model_sha256": entries.load(home / ACTOR / "model").entry_sha256, "closed_loop": []}
    (home / ACTOR / "evaluation").mkdir()
    (home / ACTOR / "evaluation" / "evaluation.json").write_text(json.dumps(figures))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_data_set_that_does_not_fit_is_refused_before_it_is_begun(home, command, small_disk):
    status, complaint = command("collect", "--config", DATA_RECIPE, "--path", str(small_disk / "data"))
    assert status == 1
    assert "The data set needs" in complaint and "MB free" in complaint


def test_a_disk_that_fills_up_meanwhile_is_named(home, command, small_disk, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(1 << 60, 0, 1 << 60))
    status, complaint = command("collect", "--config", DATA_RECIPE, "--path", str(small_disk / "data"))
    assert status == 1 and "No space left on device" in complaint
    assert not (small_disk / "data").exists()


def test_a_disk_that_fills_up_during_an_import_is_an_error_and_leaves_nothing(tmp_path, monkeypatch):
    """Where a map has no blocks of its own, the process would die of a signal on the first byte that has no room."""
    free = 100_000

    def fill(file: int, start: int, size: int) -> None:
        nonlocal free
        free -= size
        if free < 0:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", fill)
    drive = {"pixels": np.zeros((3, 64, 64, 3), np.uint8), "action": np.zeros((3, 1), np.float32)}
    with pytest.raises(OSError, match="No space left on device"):
        write_data_set(tmp_path / "set", {"train": [drive] * 2, "test": [drive]}, {})
    assert -20_000 < free < 0 and list(tmp_path.iterdir()) == []


def test_a_checkpoint_that_does_not_fit_leaves_the_one_before(home, command, file_size_limit):
    before = contents(home / RUN / "checkpoints")
    with file_size_limit(50_000):
        status, complaint = command("fit", "--config", RECIPE, "--ckpt_path", "last", "--trainer.max_epochs", "3")
    assert status == 1 and ".ckpt could not be written (File too large)" in complaint
    assert "--ckpt_path last" in complaint
    assert contents(home / RUN / "checkpoints") == before


def test_a_checkpoint_on_a_full_disk_leaves_the_one_before(small_disk):
    path = small_disk / "last.ckpt"
    AtomicCheckpointIO().save_checkpoint({"step": 1}, path)
    with pytest.raises(OSError, match=r"last\.ckpt could not be written \(No space left on device\)"):
        AtomicCheckpointIO().save_checkpoint({"step": 2, "much": torch.zeros(1_000_000)}, path)
    assert AtomicCheckpointIO().load_checkpoint(path) == {"step": 1}
    assert [file.name for file in small_disk.iterdir()] == ["last.ckpt"]


def test_an_entry_that_does_not_fit_leaves_the_one_before(evaluation, home, command, file_size_limit):
    assert command(*EXPORT)[0] == 0
    before = contents(home / "checkpoints")
    with file_size_limit(2_000):
        status, complaint = command(*EXPORT)
    assert status == 1 and "could not be written to checkpoints/tiny" in complaint
    assert contents(home / "checkpoints") == before


def test_text_that_does_not_fit_leaves_the_text_before(small_disk):
    write_text(small_disk / "search.json", "before")
    with pytest.raises(OSError, match="No space left"):
        write_text(small_disk / "search.json", "x" * 4_000_000)
    assert (small_disk / "search.json").read_text() == "before"


PICTURES = [np.random.default_rng(slot).integers(0, 256, (64, 128, 3), dtype=np.uint8) for slot in range(30)]


@pytest.mark.parametrize(
    ("write", "content", "name"), [(write_video, PICTURES, "film.mp4"), (write_picture, PICTURES[0], "strip.png")]
)
def test_a_film_or_a_picture_that_was_not_written_is_named_and_the_one_before_stays(
    tmp_path, file_size_limit, write, content, name
):
    write(tmp_path / name, content)
    before = contents(tmp_path)
    assert list(before) == [name] and len(before[name]) > 10_000
    with (
        file_size_limit(10_000),
        pytest.raises(OSError, match=rf"{name}.* could not be written|File too large: .*{name}"),
    ):
        write(tmp_path / name, content)
    assert contents(tmp_path) == before
    with pytest.raises(OSError, match=rf"absent/{name}"):
        write(tmp_path / "absent" / name, content)
    assert contents(tmp_path) == before


def test_a_film_has_its_frames_and_a_picture_its_pixels(tmp_path):
    write_video(tmp_path / "film.mp4", PICTURES)
    assert count_frames(tmp_path / "film.mp4") == 30
    write_picture(tmp_path / "strip.png", PICTURES[0])
    assert np.array_equal(cv2.imread(str(tmp_path / "strip.png"))[..., ::-1], PICTURES[0])


@pytest.mark.parametrize(
    ("arguments", "folder"),
    [
        (("collect", "--config", DATA_RECIPE, "--path", "sealed/data"), "sealed"),
        (("fit", "--config", RECIPE), "runs"),
        (EXPORT, "checkpoints"),
        (("simulate", "--config", "recipes/fleet-search.yaml"), "runs"),
    ],
)
def test_a_folder_that_may_not_be_written_is_named(evaluation, home, command, seal, arguments, folder):
    (home / folder).mkdir(exist_ok=True)
    seal(home / folder)
    status, complaint = command(*arguments)
    assert status == 1
    assert re.search("Permission denied|Read-only file system", complaint) and folder in complaint


@pytest.mark.parametrize(
    ("arguments", "folder"),
    [
        (("collect", "--config", DATA_RECIPE, "--overwrite", "true"), DATA),
        (("fit", "--config", RECIPE), RUN),
        (EXPORT, "checkpoints/tiny"),
        (("simulate", "--config", "recipes/fleet-search.yaml"), "runs/fleet-search"),
        (("evaluate", "--config", "recipes/evaluate.yaml"), "runs/evaluation"),
    ],
)
def test_a_second_run_in_the_same_folder_is_refused(evaluation, home, command, arguments, folder):
    before = contents(home)
    with exclusive(home / folder):
        status, complaint = command(*arguments)
    assert status == 2
    assert f"Another process is writing {folder}" in complaint
    assert contents(home) == before


def test_a_folder_is_free_again_after_a_run(home):
    for _ in range(2):
        with exclusive(home / RUN), pytest.raises(FileExistsError, match="Another process"), exclusive(home / RUN):
            pass
    assert not list(home.rglob("*.lock"))


@pytest.mark.parametrize("exchange", [True, False])
def test_a_folder_is_replaced(tmp_path, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr("sys.platform", "another")
    for number in range(3):
        (tmp_path / "new").mkdir()
        (tmp_path / "new" / "number").write_text(str(number))
        replace_folder(tmp_path / "new", tmp_path / "place")
        assert (tmp_path / "place" / "number").read_text() == str(number)
        assert [path.name for path in tmp_path.iterdir()] == ["place"]


def test_a_journal_counts_whole_lines_of_the_same_settings(tmp_path):
    path = tmp_path / "journal"
    for key in "abc":
        Journal(path, {"seed": 1}).add(key, {"score": 0.1})
    path.write_text(path.read_text()[:-3])
    journal = Journal(path, {"seed": 1})
    assert journal.done == {"a": {"score": 0.1}, "b": {"score": 0.1}}
    journal.add("c", 0.1)
    assert Journal(path, {"seed": 1}).done["c"] == 0.1
    assert Journal(path, {"seed": 2}).done == {}
    assert Journal(path, {"seed": 1}).done == {}


def test_a_cut_map_is_named_by_the_fit(home, command):
    pixels = home / DATA / "train" / "pixels.memmap"
    pixels.write_bytes(pixels.read_bytes()[:-1])
    status, complaint = command("fit", "--config", RECIPE)
    assert status == 2 and "is damaged: train/pixels.memmap has" in complaint


@pytest.mark.parametrize("name", [METADATA, "train/meta.json"])
def test_a_damaged_description_of_a_data_set_is_named(home, command, name):
    path = home / DATA / name
    path.write_text(path.read_text().replace('"', "'", 1))
    status, complaint = command("fit", "--config", RECIPE)
    assert status == 2 and "damaged" in complaint and str(DATA) in complaint


@pytest.mark.parametrize("name", [f"{ACTOR}/evaluation/evaluation.json", "seeds.json"])
@pytest.mark.parametrize("content", ['{"model_sha256": "4', "", "[]"])
def test_a_damaged_result_is_named_by_the_export(evaluation, home, command, name, content):
    (home / name).write_text(content)
    options = ("--training_seeds", "seeds.json") if name == "seeds.json" else ()
    status, complaint = command(*EXPORT, *options)
    assert status == 2 and f"{name} is damaged: it " in complaint and "make it anew" in complaint


def spoil(split: TensorDict, key: str) -> None:
    if key == "pixels":
        split["pixels"][1] = split["pixels"][1, 0].clone()
    else:
        split[key][1, 3] = np.nan


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("state", "state is not finite"),
        ("action", "action is not finite"),
        ("pixels", "frames of its trajectory 1 are"),
    ],
)
def test_data_that_make_no_sense_are_refused_before_the_fit(home, command, key, said):
    spoil(open_split(home / DATA, "train"), key)
    status, complaint = command("fit", "--config", RECIPE)
    assert status == 2 and said in complaint and "the data set anew" in complaint


def test_weights_that_were_tampered_with_are_refused_by_every_command(evaluation, home, command):
    weights = home / RUN / "model" / entries.WEIGHTS
    weights.write_bytes(weights.read_bytes()[:-1] + b"\x7f")
    recipe = yaml.safe_load((home / "recipes" / "actor.yaml").read_text())
    assert recipe["model"]["init_args"]["pretrained"] == f"{RUN}/model"
    for arguments in (
        ("export", str(RUN), "tiny"),
        ("evaluate", "--model", f"{RUN}/model"),
        ("fit", "--config", "recipes/actor.yaml"),
    ):
        status, complaint = command(*arguments)
        assert status == 2 and "is not the file that the manifest names" in complaint
