"""Fits the state probe on frozen embeddings when a fit ends; nothing of it reaches the encoder or the actor."""

from __future__ import annotations

from collections.abc import Sequence

import lightning
import torch
from torch import Tensor

from tsjepa.models import StateProbe
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.embeddings import embedded
from tsjepa.training.finish.callback import Finish
from tsjepa.training.finish.minimize import minimize
from tsjepa.training.statistics import mean_and_std


def fit_probe(
    probe: StateProbe,
    embedding: Tensor,
    state: Tensor,
    steps: int,
    batch_size: int = 512,
    learning_rate: float = 2e-3,
    seed: int = 0,
) -> None:
    """Trains the probe in place on squared errors, each component of the state over its standard deviation.

    It computes in float32 whatever the trainer does: a state is wanted in millimetres, and the probe is small.

    Args:
        probe: its ``state_mean`` and ``state_std`` are set from ``state``.
        embedding: [N, d].
        state: [N, n].
        steps, batch_size, learning_rate: of AdamW with warm-up and cosine decay.
        seed: seed of the batches.
    """
    mean, std = mean_and_std(state)
    probe.state_mean.copy_(mean)
    probe.state_std.copy_(std)
    generator = torch.Generator().manual_seed(seed)

    def loss() -> Tensor:
        rows = torch.randint(len(embedding), (batch_size,), generator=generator).to(embedding.device)
        return ((probe(embedding[rows]) - state[rows]) / probe.state_std).square().mean()

    minimize(loss, probe.parameters(), steps, learning_rate, 1e-4, "fit probe")


class FitProbe(Finish):
    """Runs :func:`fit_probe` on the controller's probe when the fit ends. List it before the export.

    Args:
        steps: optimizer steps.
        splits: of the data set.
    """

    def __init__(self, steps: int = 4000, splits: Sequence[str] = ("train", "actor_train")) -> None:
        self.steps, self.splits = steps, tuple(splits)

    def finish(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        model, data = module.controller(), trainer.datamodule
        if model.probe is None:
            trainer.print("The data have no states: there is no probe.")
            return
        rows = torch.cat([embedded(data, model, name).flatten(0, 1) for name in self.splits])
        fit_probe(model.probe, rows["embedding"], rows["state"], self.steps, seed=derive(run_seed(), "probe"))
