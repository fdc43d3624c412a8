"""Data parallelism: what makes several processes take the step that one would take with all their windows."""

from __future__ import annotations

import torch
from torch import Tensor, distributed


def rank_and_world_size() -> tuple[int, int]:
    """Number of this process, and how many there are; (0, 1) outside data parallelism."""
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank(), distributed.get_world_size()
    return 0, 1


def gather(rows: Tensor) -> Tensor:
    """The rows [N, d] of all processes, [world size * N, d], for a loss over the whole batch.

    Gradients flow back to every process's rows; with the mean that DistributedDataParallel takes they are those of one
    process with the whole batch.
    """
    if rank_and_world_size()[1] == 1:
        return rows
    from torch.distributed.nn.functional import all_gather

    return torch.cat(all_gather(rows))
