import json
from types import SimpleNamespace

import pytest
import tiny_data
import torch

from tsjepa.data.module import Trajectories
from tsjepa.data.storage import METADATA


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tiny_data.write(tmp_path_factory.mktemp("module") / "data", slots=12, train=5, validation=3, test=1)


def test_episodes_limits_every_split_and_all_that_is_made_of_it(path):
    data = Trajectories(path, episodes=2, frames_per_batch=16, stacks=4, steps=[1])
    assert [len(data.split(name)) for name in ("train", "validation", "test")] == [2, 2, 1]
    assert torch.equal(data.split("train")["state"], Trajectories(path).split("train")["state"][:2])
    loader = data.train_dataloader()
    assert len(loader.dataset.action) == 2 * 13
    assert max(int(window.episode.max()) for window in loader.sampler) < 2
    assert all(len(batch) == 2 for batch in data.val_dataloader())


def test_a_split_stays_on_the_disk_and_a_batch_goes_to_the_device(path):
    data = Trajectories(path, frames_per_batch=16, stacks=4, steps=[1])
    (split,) = data.val_dataloader()
    device = torch.device("meta")
    assert data.transfer_batch_to_device(split, device, 0) is split
    batch = next(iter(data.train_dataloader()))
    assert data.transfer_batch_to_device(batch, device, 0)["patches"].device == device


@pytest.fixture
def in_views(tmp_path):
    """A data set whose four episodes for training are two trajectories in two views."""
    folder = tiny_data.write(tmp_path / "views", slots=12, train=4, validation=3)
    metadata = json.loads((folder / METADATA).read_text())
    metadata["splits"]["train"]["views"] = 2
    (folder / METADATA).write_text(json.dumps(metadata))
    return folder


def test_episodes_counts_trajectories_and_not_their_views(in_views):
    data = Trajectories(in_views, episodes=1)
    assert len(data.split("train")) == 2 and len(data.split("validation")) == 1


def test_pairs_are_taken_from_data_that_has_them_only(path, in_views):
    data = Trajectories(in_views, frames_per_batch=16, stacks=4, steps=[1], paired=True)
    data.setup("fit")
    assert next(iter(data.train_dataloader()))["target_patches"].shape == (4, 4, 16, 32, 96)
    with pytest.raises(ValueError, match=r"the split train of .* has 1; collect it with views: 2"):
        Trajectories(path, paired=True).setup("fit")


def test_splits_of_different_lengths_are_refused_before_the_fit(tmp_path):
    folder = tiny_data.write(tmp_path / "data", slots=12, train=4, validation=3)
    tiny_data.write(tmp_path / "short", slots=7, starts=2)
    (tmp_path / "short" / "starts").rename(folder / "starts")
    metadata = json.loads((folder / METADATA).read_text())
    metadata["splits"]["starts"] = json.loads((tmp_path / "short" / METADATA).read_text())["splits"]["starts"]
    (folder / METADATA).write_text(json.dumps(metadata))
    with pytest.raises(ValueError, match=r"different lengths, in slots train 12, starts 7: train on splits of one"):
        Trajectories(folder, splits=["train", "starts"]).setup("fit")
    Trajectories(folder).setup("fit")  # which has the other split for its finish
    with pytest.raises(ValueError, match="splits is empty"):
        Trajectories(folder, splits=[])
    with pytest.raises(KeyError, match="has no split 'tain'"):
        Trajectories(folder, splits=["tain"], paired=True).setup("fit")


def test_a_fit_without_its_split_for_validation_is_refused_before_it_begins(tmp_path):
    folder = tiny_data.write(tmp_path / "data", slots=12, train=4)
    with pytest.raises(ValueError, match=r"no split 'validation' to validate on.*--trainer.limit_val_batches 0"):
        Trajectories(folder).setup("fit")
    unwatched = Trajectories(folder)
    unwatched.trainer = SimpleNamespace(limit_val_batches=0)
    unwatched.setup("fit")


def test_frames_that_make_no_whole_patches_are_refused_with_a_size_that_does(tmp_path):
    folder = tiny_data.write(tmp_path / "data", slots=12, train=4, validation=2)
    metadata = json.loads((folder / METADATA).read_text())
    metadata["spec"]["frame"] = [50, 67]
    (folder / METADATA).write_text(json.dumps(metadata))
    with pytest.raises(ValueError, match=r"are 50 x 67, .* multiples of 4: .*--size '\[48, 64\]'"):
        Trajectories(folder).setup()
