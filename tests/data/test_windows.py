import subprocess
import sys

import pytest
import torch
from tensordict import TensorDict

from tsjepa.data.windows import Window, WindowDataset, WindowSampler, patches_of
from tsjepa.models.encoder import patchify, unpatchify


def numbered_split(episodes: int = 3, frames: int = 20) -> TensorDict:
    """Every pixel of a frame holds the frame's number, and commands are numbered alike."""
    number = torch.arange(episodes * frames).view(episodes, frames)
    pixels = number.to(torch.uint8)[..., None, None, None].expand(episodes, frames, 4, 8, 3).contiguous()
    action = number[..., None].float()
    return TensorDict({"pixels": pixels, "action": action, "expert_action": -action}, batch_size=[episodes, frames])


def test_a_window_holds_the_frames_and_commands_of_its_slots():
    dataset = WindowDataset([numbered_split()], stacks=3, frame_stack=2, frame_spacing=2)
    batch = dataset[Window(torch.tensor([1, 2]), torch.tensor([5, 2]), step=4)]
    numbers = unpatchify(batch["patches"].flatten(0, 1))[..., 0, 0, 0].unflatten(0, (2, 3)).long()
    # episode 1 starts at frame 20: stacks end at slots 5, 9, 13, each with the frame two slots before
    assert numbers[0].tolist() == [[23, 25], [27, 29], [31, 33]]
    assert batch["commands"][0, :, 0].tolist() == list(range(25, 33))
    assert batch["expert_action"][0, :, 0].tolist() == [-25, -29, -33]
    assert numbers[1, 0].tolist() == [40, 42]


def test_the_episodes_of_a_second_split_are_numbered_on():
    second = numbered_split()
    second["action"] += 1000
    dataset = WindowDataset([numbered_split(), second], stacks=2, frame_stack=1, frame_spacing=1)
    batch = dataset[Window(torch.tensor([4]), torch.tensor([3]), step=1)]
    assert batch["commands"][0, :, 0].tolist() == [1000 + 20 + 3]


def test_a_batch_of_several_splits_takes_every_frame_from_its_own():
    parts = [numbered_split(2), numbered_split(1), numbered_split(3)]
    for index, part in enumerate(parts):
        part["pixels"] += 100 * index
    dataset = WindowDataset(parts, stacks=1, frame_stack=2, frame_spacing=1)
    batch = dataset[Window(torch.tensor([3, 0, 2, 5, 1]), torch.tensor([4, 4, 19, 7, 1]), step=1)]
    numbers = unpatchify(batch["patches"].flatten(0, 1))[..., 0, 0, 0].long()
    assert numbers.tolist() == [[203, 204], [3, 4], [118, 119], [246, 247], [20, 21]]


def test_patches_are_those_of_the_encoder():
    frames = torch.randint(0, 256, (5, 64, 128, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    assert torch.equal(patches_of(frames), patchify(frames[:, None]))


READ_MORE_THAN_FITS = """
import resource, sys
import torch
from tensordict import MemoryMappedTensor, TensorDict
from tsjepa.data.windows import Window, WindowDataset

episodes, frames = 800, 101  # 2 GB of pixels in a file with holes, which takes no room on the disk
with open(sys.argv[1], "wb") as file:
    file.truncate(episodes * frames * 64 * 128 * 3)
pixels = MemoryMappedTensor.from_filename(sys.argv[1], torch.uint8, torch.Size((episodes, frames, 64, 128, 3)))
action = torch.zeros(episodes, frames, 1)
split = TensorDict({"pixels": pixels, "action": action, "expert_action": action}, batch_size=[episodes, frames])
in_use = int(open("/proc/self/status").read().split("VmData:")[1].split()[0]) * 1024
resource.setrlimit(resource.RLIMIT_DATA, (in_use + 2**29, -1))
dataset = WindowDataset([split], stacks=8, frame_stack=2, frame_spacing=1)
for start in range(0, episodes, 32):
    batch = dataset[Window(torch.arange(start, start + 32), torch.full((32,), 50), step=4)]
assert batch["patches"].shape == (32, 8, 16, 32, 96)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits the memory of a process as Linux does")
@pytest.mark.slow
def test_a_data_set_larger_than_memory_is_read(tmp_path):
    """Half a gigabyte for a data set of two."""
    program = [sys.executable, "-c", READ_MORE_THAN_FITS, str(tmp_path / "pixels.memmap")]
    done = subprocess.run(program, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-500:]


def sampler(**changes) -> WindowSampler:
    settings = {
        "episodes": 4,
        "frames": 30,
        "first": 2,
        "stacks": 4,
        "windows_per_batch": 8,
        "steps": (1, 3),
        "seed": 5,
    }
    return WindowSampler(**{**settings, **changes})


def test_windows_stay_inside_their_trajectories():
    for window in sampler():
        assert window.start.min() >= 2
        assert (window.start + 3 * window.step).max() <= 29


def test_a_share_of_the_windows_begins_where_the_trajectory_begins():
    starts = torch.cat([window.start for window in sampler(episodes=4000, steps=(1,), start_share=0.25)])
    at_the_start = (starts == 2).double().mean()  # 0.25, and one in 25 of the others: 0.28
    assert abs(at_the_start - 0.28) < 4 * (0.28 * 0.72 / len(starts)) ** 0.5


def test_an_epoch_is_a_function_of_seed_and_epoch():
    def draws(epoch, **changes):
        drawn = sampler(**changes)
        drawn.set_epoch(epoch)
        return torch.stack([torch.stack((window.episode, window.start)) for window in drawn])

    assert torch.equal(draws(3), draws(3))
    assert not torch.equal(draws(3), draws(4))
    assert not torch.equal(draws(3), draws(3, seed=6))


def test_processes_share_a_batch_without_overlap():
    whole = list(sampler())
    parts = [list(sampler(rank=rank, world_size=2)) for rank in (0, 1)]
    for batch, first, second in zip(whole, *parts, strict=True):
        assert torch.equal(torch.stack((first.start, second.start), 1).flatten(), batch.start)


def test_windows_longer_than_the_trajectories_are_refused():
    with pytest.raises(ValueError, match="need 33 frames"):
        sampler(steps=(10,))
    with pytest.raises(ValueError, match="do not divide"):
        sampler(windows_per_batch=9, world_size=2)


def test_a_paired_window_has_the_same_slots_of_the_other_view():
    dataset = WindowDataset([numbered_split(4)], stacks=3, frame_stack=2, frame_spacing=2, paired=True)
    batch = dataset[Window(torch.tensor([1, 2]), torch.tensor([5, 2]), step=4)]
    numbers, others = (
        unpatchify(batch[key].flatten(0, 1))[..., 0, 0, 0].unflatten(0, (2, 3)).long()
        for key in ("patches", "target_patches")
    )
    # episodes 0 and 1 are one trajectory, and so are 2 and 3; each has 20 frames
    assert torch.equal(others[0], numbers[0] - 20) and torch.equal(others[1], numbers[1] + 20)
    assert numbers[0].tolist() == [[23, 25], [27, 29], [31, 33]]
