"""Data parallelism: what makes several processes take the step that one would take with all their windows."""

from __future__ import annotations

import torch
from torch import Tensor, distributed
from torch.nn import functional as F


def rank_and_world_size() -> tuple[int, int]:
    """Number of this process, and how many there are; (0, 1) outside data parallelism."""
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank(), distributed.get_world_size()
    return 0, 1


def gather(rows: Tensor) -> Tensor:
    """The rows [N, d] of all processes, one after the other, for a loss over the whole batch; N may differ.

    Gradients flow back to every process's rows; with the mean that DistributedDataParallel takes they are those of one
    process with the whole batch.
    """
    if rank_and_world_size()[1] == 1:
        return rows
    from torch.distributed.nn.functional import all_gather

    own = torch.tensor([len(rows)], device=rows.device)
    counts = [torch.zeros_like(own) for _ in range(rank_and_world_size()[1])]
    distributed.all_gather(counts, own)
    counts = torch.cat(counts).tolist()
    padded = all_gather(F.pad(rows, (0, 0, 0, max(counts) - len(rows))))
    return torch.cat([part[:count] for part, count in zip(padded, counts, strict=True)])
