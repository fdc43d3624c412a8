import json

import numpy as np
import pytest
import torch
from tsjepa.plants.expert import Expert

from tsjepa.data.collect import Coverage, Split, collect
from tsjepa.data.storage import METADATA, content_hash, open_split, read_metadata
from tsjepa.envs import Renderer

SPLITS = {"train": Split(3), "test": Split(2, coverage=False)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return collect(str(tmp_path_factory.mktemp("data") / "tiny"), SPLITS, slots=30, seed=7)


def test_each_frame_shows_the_state_beside_it(folder):
    split = open_split(folder, "train")
    assert split.batch_size == (3, 31)
    qpos = split["state"][1, :, :2].double().numpy()
    assert np.array_equal(split["pixels"][1].numpy(), Renderer().render(qpos))


def test_the_plain_split_is_the_expert_and_the_other_is_not(folder):
    plain, covered = open_split(folder, "test"), open_split(folder, "train")
    assert torch.equal(plain["expert_action"], Expert(0.02)(plain["state"].clone()))
    assert torch.equal(plain["action"][:, :-1], plain["expert_action"][:, :-1])
    assert (covered["action"][:, :-1] - covered["expert_action"][:, :-1]).abs().mean() > 1
    assert (plain["action"][:, -1] == 0).all()


def test_a_warm_up_runs_without_force_and_the_expert_takes_over_after_it(tmp_path):
    split = open_split(collect(str(tmp_path / "warm"), SPLITS, slots=6, warmup_slots=2, seed=7), "test")
    assert (split["action"][:, :2] == 0).all()
    assert torch.equal(split["action"][:, 2:-1], split["expert_action"][:, 2:-1])


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(folder, tmp_path):
    again = collect(str(tmp_path / "again"), SPLITS, slots=30, seed=7)
    other = collect(str(tmp_path / "other"), SPLITS, slots=30, seed=8)
    assert content_hash(again) == content_hash(folder) == read_metadata(folder)["sha256"]
    assert content_hash(other) != content_hash(folder)


def test_it_does_not_overwrite_unless_told(folder):
    with pytest.raises(FileExistsError, match="--overwrite"):
        collect(str(folder), SPLITS, slots=30)


def test_an_interrupted_collection_leaves_nothing_that_loads(tmp_path, monkeypatch):
    rendered = 0

    def fail_later(self, qpos, colors=None):
        nonlocal rendered
        rendered += 1
        if rendered > 2:
            raise KeyboardInterrupt
        return np.zeros((len(qpos), self.height, self.width, 3), np.uint8)

    with monkeypatch.context() as patch:
        patch.setattr(Renderer, "render", fail_later)
        with pytest.raises(KeyboardInterrupt):
            collect(str(tmp_path / "cut"), SPLITS, slots=10)
    with pytest.raises(FileNotFoundError, match="tsjepa collect"):
        read_metadata(tmp_path / "cut")
    collect(str(tmp_path / "cut"), SPLITS, slots=10)
    assert open_split(tmp_path / "cut", "test").batch_size == (2, 11)


def test_a_truncated_or_missing_file_is_named(tmp_path):
    folder = collect(str(tmp_path / "hurt"), SPLITS, slots=10)
    pixels = folder / "train" / "pixels.memmap"
    pixels.write_bytes(pixels.read_bytes()[:-1])
    with pytest.raises(ValueError, match=r"train/pixels\.memmap has"):
        open_split(folder, "test")
    pixels.unlink()
    with pytest.raises(ValueError, match="has no bytes"):
        open_split(folder, "test")


def test_another_format_and_a_wrong_split_are_refused(folder, tmp_path):
    with pytest.raises(KeyError, match="no split 'valid'"):
        open_split(folder, "valid")
    metadata = json.loads((folder / METADATA).read_text())
    (tmp_path / METADATA).write_text(json.dumps({**metadata, "format": 99}))
    with pytest.raises(ValueError, match="format 99"):
        read_metadata(tmp_path)


def test_coverage_noise_has_the_stated_memory_and_spread():
    set_points, noise = Coverage(noise_memory=0.8, noise_std=1.5).draw(400, 100, torch.Generator().manual_seed(0))
    late = noise[:, 40:, 0]
    assert abs(late.std() - 1.5 / (1 - 0.64) ** 0.5) < 0.1
    assert abs((late[:, 1:] * late[:, :-1]).mean() / late.square().mean() - 0.8) < 0.02
    changes = (set_points[:, 1:] != set_points[:, :-1]).float().mean(0)
    assert torch.equal(changes.nonzero()[:, 0] + 1, torch.tensor([25, 50, 75]))
    assert abs(changes[24] - 0.7) < 3 * (0.21 / 400) ** 0.5
