"""A process of the test of data parallelism: its loss over rows that the processes have unequal numbers of."""

import sys

import torch
from torch import distributed

from tsjepa.support.parallel import gather

COUNTS = (5, 2)


def rows() -> torch.Tensor:
    """Those of one process with the whole batch."""
    return torch.randn(sum(COUNTS), 3, generator=torch.Generator().manual_seed(0))


def loss(whole: torch.Tensor) -> torch.Tensor:
    """A term that looks at all rows at once."""
    return whole.var(0).sqrt().sum()


if __name__ == "__main__":
    rank, folder = int(sys.argv[1]), sys.argv[2]
    distributed.init_process_group("gloo", f"file://{folder}/meet", rank=rank, world_size=len(COUNTS))
    own = rows().split(COUNTS)[rank].clone().requires_grad_()
    value = loss(gather(own))
    value.backward()
    torch.save((value.detach(), own.grad), f"{folder}/{rank}.pt")
    distributed.barrier()  # gloo aborts a process whose peer has left in the middle of its last message
    distributed.destroy_process_group()
