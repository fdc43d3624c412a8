import pytest
import tiny_data
import torch

from tsjepa.data.module import Trajectories


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
