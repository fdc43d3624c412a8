"""Fits the state probe on frozen embeddings when a fit ends; nothing of it reaches the encoder or the actor."""

from __future__ import annotations

from collections.abc import Sequence

import lightning
import torch
from torch import Tensor
from tqdm import trange

from tsjepa.models import StateProbe
from tsjepa.training.embeddings import embed_split
from tsjepa.training.schedule import warmup_cosine_schedule


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

    Args:
        probe: its ``state_mean`` and ``state_std`` are set from ``state``.
        embedding: [N, d].
        state: [N, 4].
        steps, batch_size, learning_rate: of AdamW with warm-up and cosine decay.
        seed: seed of the batches.
    """
    probe.state_mean.copy_(state.mean(0))
    probe.state_std.copy_(state.std(0))
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.AdamW(probe.parameters(), learning_rate, weight_decay=1e-4)
    schedule = warmup_cosine_schedule(optimizer, steps)
    for _ in trange(steps, desc="fit probe", unit="step"):
        rows = torch.randint(len(embedding), (batch_size,), generator=generator).to(embedding.device)
        loss = ((probe(embedding[rows]) - state[rows]) / probe.state_std).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()


class FitProbe(lightning.Callback):
    """Runs :func:`fit_probe` on the controller's probe when the fit ends. List it before the export.

    Args:
        steps: optimizer steps.
        splits: of the data set.
    """

    def __init__(self, steps: int = 4000, splits: Sequence[str] = ("train", "actor_train")) -> None:
        self.steps, self.splits = steps, tuple(splits)

    def on_fit_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if not trainer.is_global_zero:
            return
        model, data = module.controller(), trainer.datamodule
        spacing = model.frame_spacing
        parts = [embed_split(model.encoder, data.split(name), spacing).flatten(0, 1) for name in self.splits]
        rows = torch.cat(parts)
        fit_probe(model.probe, rows["embedding"], rows["state"], self.steps)
