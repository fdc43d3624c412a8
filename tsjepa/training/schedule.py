"""The optimizer of what is fitted on frozen embeddings, and the learning-rate schedule that everything here shares."""

from __future__ import annotations

import math
from collections.abc import Iterable

from torch import nn
from torch.optim import AdamW, Optimizer
from torch.optim.lr_scheduler import LambdaLR


def adamw(parameters: Iterable[nn.Parameter], learning_rate: float, weight_decay: float) -> AdamW:
    """AdamW, in one kernel where there is one: for small networks its many small ones cost as much as the gradient."""
    parameters = list(parameters)
    fused = all(parameter.device.type in ("cpu", "cuda") for parameter in parameters)
    return AdamW(parameters, learning_rate, weight_decay=weight_decay, fused=fused)


def warmup_cosine(progress: float, warmup: float = 0.05) -> float:
    """Learning-rate factor at ``progress`` in [0, 1]: linear warm-up, then cosine decay to zero."""
    if progress < warmup:
        return (progress + 1e-3) / (warmup + 1e-3)
    return 0.5 * (1 + math.cos(math.pi * min(1.0, (progress - warmup) / (1 - warmup))))


def warmup_cosine_schedule(optimizer: Optimizer, steps: int) -> LambdaLR:
    """:func:`warmup_cosine` over ``steps`` optimizer steps."""
    return LambdaLR(optimizer, lambda step: warmup_cosine(step / steps))
