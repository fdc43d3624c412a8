"""Reads single frames of splits from their memory maps, and gives the maps' pages back."""

from __future__ import annotations

import ctypes
import mmap
from collections.abc import Sequence
from itertools import accumulate

import torch
from tensordict import MemoryMappedTensor, TensorDictBase
from torch import Tensor


class Frames:
    """Frames of some splits, numbered on from split to split, read where they lie when they are asked for.

    What was read does not stay in the process: a data set larger than memory may be read, and one that is smaller
    does not push others out.

    Args:
        splits: [episodes, T + 1] with ``pixels``.
    """

    def __init__(self, splits: Sequence[TensorDictBase]) -> None:
        self.maps = [split["pixels"] for split in splits]
        self.pixels = [torch.from_numpy(pixels.cpu().numpy()).flatten(0, 1) for pixels in self.maps]
        self.bounds = torch.tensor(list(accumulate(map(len, self.pixels), initial=0)))

    def __deepcopy__(self, memo: dict) -> Frames:
        """Itself: nobody writes to it, and a copy would read every frame into memory."""
        return self

    def __len__(self) -> int:
        return int(self.bounds[-1])

    def __getitem__(self, numbers: Tensor) -> Tensor:
        """uint8 [..., H, W, 3] of the frames numbered [...]."""
        flat = numbers.flatten()
        split = torch.searchsorted(self.bounds, flat, right=True) - 1
        frames = self.pixels[0].new_empty(len(flat), *self.pixels[0].shape[1:])
        for index in split.unique().tolist():
            here = (split == index).nonzero()[:, 0]
            rows = flat[here] - self.bounds[index]
            if len(here) == len(flat):
                torch.index_select(self.pixels[index], 0, rows, out=frames)
            else:
                frames[here] = self.pixels[index].index_select(0, rows)
        for pixels in self.maps:
            release(pixels)
        return frames.unflatten(0, numbers.shape)


def release(pixels: Tensor) -> None:
    """Takes the pages of a memory-mapped tensor out of this process; the system keeps them, or reads them anew.

    Nothing happens to a tensor that is not a map, whose contents this would lose.
    """
    if isinstance(pixels, MemoryMappedTensor) and hasattr(mmap, "MADV_DONTNEED"):
        storage = pixels.untyped_storage()
        LIBC.madvise(ctypes.c_void_p(storage.data_ptr()), ctypes.c_size_t(storage.nbytes()), mmap.MADV_DONTNEED)


LIBC = ctypes.CDLL(None)
