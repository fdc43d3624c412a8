"""Training windows: which frames and commands make one batch, as a pure function of (seed, epoch, index)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.utils.data import Dataset, Sampler

from tsjepa.data.frames import Frames
from tsjepa.models.encoder import PATCH
from tsjepa.support.seeds import derive


@dataclass(frozen=True)
class Window:
    """Rows of one batch of windows.

    Args:
        episode: [B] int64.
        start: [B] int64, slot of the newest frame of the window's first stack.
        step: slots between two stacks of the window.
    """

    episode: Tensor
    start: Tensor
    step: int


class WindowSampler(Sampler[Window]):
    """Shuffles all windows anew every epoch; a resumed run draws what the interrupted one would have drawn.

    A batch takes every window's stacks ``step`` slots apart, one step a batch, so that long horizons are seen without
    encoding more frames. Under data parallelism every process takes its share of each batch.

    Args:
        episodes: number of trajectories.
        frames: frames per trajectory, T + 1.
        first: first slot that has a whole stack behind it.
        stacks: stacks per window, W.
        windows_per_batch: B, over all processes.
        steps: the steps to draw from, each as likely as it is listed.
        seed: of the run; the windows have a stream of their own in it.
        rank, world_size: this process among all.
        start_share: share of the windows that begin where the trajectory begins; the others begin anywhere.

    Raises:
        ValueError: a window is longer than the trajectories, or the windows do not divide among the processes.
    """

    def __init__(
        self,
        episodes: int,
        frames: int,
        *,
        first: int,
        stacks: int,
        windows_per_batch: int,
        steps: Sequence[int],
        seed: int,
        rank: int = 0,
        world_size: int = 1,
        start_share: float = 0.0,
    ) -> None:
        span = max(steps) * (stacks - 1)
        if first + span >= frames:
            raise ValueError(
                f"{stacks} stacks {max(steps)} slots apart need {first + span + 1} frames and the trajectories have "
                f"{frames}; take fewer stacks or smaller steps."
            )
        if windows_per_batch % world_size:
            raise ValueError(f"{windows_per_batch} windows a batch do not divide among {world_size} processes.")
        self.episodes, self.frames, self.first, self.stacks = episodes, frames, first, stacks
        self.windows_per_batch, self.steps, self.seed = windows_per_batch, list(steps), seed
        self.rank, self.world_size, self.start_share = rank, world_size, start_share
        self.epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning at the start of every epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        # one epoch shows every frame about once, whatever the window's length
        return max(1, self.episodes * (self.frames - self.first) // (self.windows_per_batch * self.stacks))

    def __iter__(self) -> Iterator[Window]:
        generator = torch.Generator().manual_seed(derive(self.seed, "windows", self.epoch))
        for _ in range(len(self)):
            step = self.steps[int(torch.randint(len(self.steps), (), generator=generator))]
            last = self.frames - step * (self.stacks - 1)
            episode = torch.randint(self.episodes, (self.windows_per_batch,), generator=generator)
            start = torch.randint(self.first, last, (self.windows_per_batch,), generator=generator)
            if self.start_share:
                start[torch.rand(self.windows_per_batch, generator=generator) < self.start_share] = self.first
            yield Window(episode[self.rank :: self.world_size], start[self.rank :: self.world_size], step)


class WindowDataset(Dataset):
    """Gathers the frames and commands of a :class:`Window` from one or more splits, whose episodes are numbered on.

    A batch's frames are read from the splits' memory maps, so that a data set may be larger than memory.

    Args:
        splits: batch sizes [episodes, T + 1] with the same T, keys ``pixels``, ``action`` and, where
            an expert labelled it, ``expert_action``.
        stacks: W.
        frame_stack: kappa.
        frame_spacing: slots between the frames of a stack.
        paired: episodes 2 i and 2 i + 1 show one trajectory in two appearances, and a window has both.
    """

    def __init__(
        self,
        splits: Sequence[TensorDictBase],
        stacks: int,
        frame_stack: int,
        frame_spacing: int,
        paired: bool = False,
    ) -> None:
        self.pixels = Frames(splits)
        self.action = torch.cat([split["action"].flatten(0, 1) for split in splits])
        self.expert_action = torch.cat([split.get("expert_action", split["action"]).flatten(0, 1) for split in splits])
        self.frames, self.stacks = splits[0].shape[1], stacks
        self.paired = paired
        self.offsets = frame_spacing * torch.arange(1 - frame_stack, 1)

    def __getitem__(self, window: Window) -> TensorDict:
        """Gathers one batch [B].

        Returns:
            The stacks' ``patches`` uint8 [W, H / 4, W / 4, 48 * kappa] (see
            :func:`tsjepa.models.encoder.patchify`), the ``commands`` [step * (W - 1), m] that were applied
            from the first to the last stack and the ``expert_action`` [W, m] of the supervised baseline. Where
            trajectories are paired, ``target_patches`` are the same stacks in the other appearance.
        """
        newest = window.episode * self.frames + window.start
        stacks = newest[:, None] + window.step * torch.arange(self.stacks)
        slots = newest[:, None] + torch.arange(window.step * (self.stacks - 1))
        batch = {
            "patches": self.stack(stacks),
            "commands": self.action[slots],
            "expert_action": self.expert_action[stacks],
        }
        if self.paired:
            other = (window.episode ^ 1) - window.episode
            batch["target_patches"] = self.stack(stacks + self.frames * other[:, None])
        return TensorDict(batch, batch_size=[len(newest)])

    def stack(self, newest: Tensor) -> Tensor:
        """Patches [..., H / 4, W / 4, 48 * kappa] of the stacks that end at the frames numbered ``newest`` [...]."""
        numbers, places = (newest.flatten()[:, None] + self.offsets).unique(return_inverse=True)
        patches = patches_of(self.pixels[numbers])
        stacks = patches.new_empty(newest.numel(), *patches.shape[1:3], len(self.offsets), patches.shape[3])
        for frame in range(len(self.offsets)):
            # straight to its place: to concatenate afterwards would read and write every byte once more
            torch.index_select(patches, 0, places[:, frame], out=stacks[..., frame, :])
        return stacks.flatten(3).unflatten(0, newest.shape)


def patches_of(frames: Tensor) -> Tensor:
    """:func:`tsjepa.models.encoder.patchify` of single uint8 frames [N, H, W, 3] on the CPU, in an eighth of its time.

    A row of a patch is moved as one number of 12 bytes.
    """
    count, height, width, colors = frames.shape
    rows = frames.numpy().reshape(count, height // PATCH, PATCH, -1).view(f"V{PATCH * colors}")
    patches = np.ascontiguousarray(rows.transpose(0, 1, 3, 2)).view(np.uint8)
    return torch.from_numpy(patches.reshape(count, height // PATCH, width // PATCH, PATCH**2 * colors))
