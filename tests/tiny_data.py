"""A data set on disk without a renderer: a bright square on a spring that the command pushes sideways.

Up and down it swings by itself.
"""

from pathlib import Path

import torch
from tensordict import TensorDict
from torch import Tensor

from tsjepa.data.storage import publish
from tsjepa.plants import CartPole

SPLITS = {"train": 4, "validation": 2, "test": 2, "actor_train": 3, "actor_test": 2}
SIDE = 12  # pixels of the square


def covered(start: Tensor, pixels: int) -> Tensor:
    """Share of each of so many pixels that the square covers, [..., pixels], from where it starts [...] in pixels."""
    edge = torch.arange(pixels)
    return (torch.minimum(edge + 1.0, start[..., None] + SIDE) - torch.maximum(edge, start[..., None])).clamp(0, 1)


def split(episodes: int, slots: int, seed: int) -> TensorDict:
    """[episodes, slots + 1]; the state is (x, height, and their changes in a slot)."""
    generator = torch.Generator().manual_seed(seed)
    command = (10 * torch.randn(episodes, slots + 1, 1, generator=generator)).clamp(-20, 20)
    x, rate, states = torch.zeros(episodes, 1), torch.zeros(episodes, 1), []
    phase = 6.3 * torch.rand(episodes, 1, generator=generator)
    for slot in range(slots + 1):
        height, climb = 0.2 * torch.sin(slot / 6 + phase), 0.2 / 6 * torch.cos(slot / 6 + phase)
        states.append(torch.cat((x, height, rate, climb), dim=1))
        rate = 0.9 * rate - 0.03 * x + 0.003 * command[:, slot]
        x = x + rate
    state = torch.stack(states, dim=1)
    rows, columns = covered(26 + 70 * state[..., 1], 64), covered(58 + 60 * state[..., 0], 128)
    pixels = (60 + 190 * rows[..., :, None] * columns[..., None, :]).to(torch.uint8)
    expert = (-20 * state[..., :1] - 100 * state[..., 2:3]).clamp(-20, 20)
    values = {"state": state, "action": command, "expert_action": expert}
    return TensorDict({**values, "pixels": pixels[..., None].repeat(1, 1, 1, 1, 3)}, batch_size=[episodes, slots + 1])


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
