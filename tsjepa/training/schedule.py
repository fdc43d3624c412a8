"""The learning-rate schedule that everything here shares."""

from __future__ import annotations

import math

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR


def warmup_cosine(progress: float, warmup: float = 0.05) -> float:
    """Learning-rate factor at ``progress`` in [0, 1]: linear warm-up, then cosine decay to zero."""
    if progress < warmup:
        return (progress + 1e-3) / (warmup + 1e-3)
    return 0.5 * (1 + math.cos(math.pi * min(1.0, (progress - warmup) / (1 - warmup))))


def warmup_cosine_schedule(optimizer: Optimizer, steps: int) -> LambdaLR:
    """:func:`warmup_cosine` over ``steps`` optimizer steps."""
    return LambdaLR(optimizer, lambda step: warmup_cosine(step / steps))
