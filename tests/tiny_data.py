"""A data set on disk without a renderer: a bright square that a force pushes, at two heights for the two angles."""

from pathlib import Path

import torch
from tensordict import TensorDict

from tsjepa.data.storage import publish
from tsjepa.plants import CartPole

SPLITS = {"train": 4, "validation": 2, "test": 2, "actor_train": 3, "actor_test": 2}


def split(episodes: int, slots: int, seed: int) -> TensorDict:
    """[episodes, slots + 1] of a square whose state is (x, height, and their rates); the command pushes x."""
    generator = torch.Generator().manual_seed(seed)
    command = 10 * torch.randn(episodes, slots + 1, 1, generator=generator)
    rate = (0.002 * command).cumsum(1)
    height = 0.2 * torch.sin(torch.arange(slots + 1) / 9 + 6 * torch.rand(episodes, 1, generator=generator))[..., None]
    state = torch.cat((rate.cumsum(1).clamp(-0.8, 0.8), height, rate, height.diff(dim=1, append=height[:, -1:])), -1)
    pixels = torch.full((episodes, slots + 1, 64, 128, 3), 60, dtype=torch.uint8)
    for frames, states in zip(pixels, state, strict=True):
        for frame, (x, y, *_) in zip(frames, states.tolist(), strict=True):
            column, row = round(60 + 60 * x), round(28 + 100 * y)
            frame[max(0, row) : row + 12, max(0, column) : column + 12] = 250
    values = {"pixels": pixels, "state": state, "action": command, "expert_action": -20 * state[..., :1]}
    return TensorDict(values, batch_size=[episodes, slots + 1])


def write(folder: Path, slots: int = 24, seed: int = 0, **splits: int) -> Path:
    """Publishes a data set of as many ``splits`` of so many trajectories, those of :data:`SPLITS` by default."""
    partial = folder.with_name(folder.name + ".partial")
    sizes = splits or SPLITS
    for index, (name, episodes) in enumerate(sizes.items()):
        split(episodes, slots, 1000 * seed + index).memmap(partial / name)
    metadata = {
        "splits": {name: {"episodes": count, "slots": slots} for name, count in sizes.items()},
        "plant": {"class_path": "tsjepa.plants.CartPole", "init_args": {"sampling_interval": 0.02}},
        "spec": CartPole(0.02).spec.to_dict(),
        "slots": slots,
    }
    publish(partial, folder, metadata)
    return folder
