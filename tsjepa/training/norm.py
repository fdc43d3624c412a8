"""Batch normalisation under data parallelism: statistics of the whole batch, on CPUs and GPUs alike."""

from __future__ import annotations

from functools import partial

import torch
from lightning.pytorch.plugins.layer_sync import LayerSync
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from tsjepa.support.parallel import gather


class WholeBatchNorm(LayerSync):
    """Lets every batch normalisation of a model see the rows of all processes while they train it together.

    Without it each process normalises with its own share, and the steps depend on the number of processes. Torch's
    ``SyncBatchNorm`` does the same on GPUs only. Names and kinds of the layers stay, so checkpoints fit both.
    """

    def apply(self, model: nn.Module) -> nn.Module:
        for part in norms(model):
            part.forward = partial(normalise, part)
        return model

    def revert(self, model: nn.Module) -> nn.Module:
        for part in norms(model):
            vars(part).pop("forward", None)
        return model


def norms(model: nn.Module) -> list[_BatchNorm]:
    """All batch normalisations but those that are synchronised by themselves."""
    parts = [part for part in model.modules() if isinstance(part, _BatchNorm)]
    return [part for part in parts if not isinstance(part, nn.SyncBatchNorm)]


def normalise(norm: _BatchNorm, values: Tensor) -> Tensor:
    """What ``norm`` makes of ``values`` [N, C, ...] with mean and variance over the rows of all processes.

    Processes may have unequal numbers of rows. Running statistics change as in one process with the whole batch.
    """
    if not norm.training:
        return type(norm).forward(norm, values)
    wide = torch.promote_types(values.dtype, torch.float32)
    channels, places = values.shape[1], (-1, *(1 for _ in values.shape[2:]))
    own_var, own_mean = torch.var_mean(values.to(wide), dim=(0, *range(2, values.ndim)), correction=0)
    own_count = own_mean.new_full((1,), values.numel() // channels)
    shares = gather(torch.cat((own_count, own_mean, own_var))[None])
    counts, means, variances = shares.split((1, channels, channels), dim=1)
    share = counts / counts.sum()
    mean = (share * means).sum(0)
    var = (share * (variances + (means - mean).square())).sum(0)
    if norm.track_running_stats:
        update_statistics(norm, mean, var, counts.sum())
    scale = (var + norm.eps).rsqrt()
    scale = scale if norm.weight is None else norm.weight * scale
    shift = -mean * scale if norm.bias is None else norm.bias - mean * scale
    return (values * scale.view(places) + shift.view(places)).to(values.dtype)


@torch.no_grad()
def update_statistics(norm: _BatchNorm, mean: Tensor, var: Tensor, count: Tensor) -> None:
    """Moves the running statistics towards those of a batch of ``count`` values a channel, as torch does."""
    norm.num_batches_tracked.add_(1)
    share = 1 / float(norm.num_batches_tracked) if norm.momentum is None else norm.momentum
    norm.running_mean.lerp_(mean, share)
    norm.running_var.lerp_(var * count / (count - 1), share)
