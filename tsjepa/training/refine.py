"""Finishes the predictor on the frozen encoder's embeddings, where a step costs a hundredth of one through it."""

from __future__ import annotations

import lightning
import torch
from tensordict import TensorDictBase
from torch import nn
from tqdm import trange

from tsjepa.models.predictor import rollout
from tsjepa.training.embeddings import embed_split
from tsjepa.training.losses import cosine_loss
from tsjepa.training.schedule import warmup_cosine_schedule


def refine_predictor(
    predictor: nn.Module,
    embedded: TensorDictBase,
    steps: int,
    horizon: int,
    batch_size: int,
    learning_rate: float,
    seed: int,
    start_share: float = 0.0,
    precision: torch.dtype = torch.bfloat16,
) -> None:
    """Trains the predictor in place with the same cosine loss over auto-regressive roll-outs.

    Args:
        predictor: one step of embedding dynamics.
        embedded: [episodes, slots] with ``embedding`` and ``action``.
        steps: optimizer steps.
        horizon: slots per roll-out.
        batch_size: roll-outs per step.
        learning_rate: peak of AdamW's warm-up and cosine decay.
        seed: seed of the roll-outs' starts.
        start_share: share of the roll-outs that begin where a trajectory begins; the others begin anywhere. A pair of
            frames does not tell what force acted between them: at a start it was none, later it was the expert's, and
            uniform roll-outs make the predictor take the expert's for granted.
        precision: autocast dtype of the roll-out.
    """
    embedding, action = embedded["embedding"], embedded["action"]
    episodes, slots = embedded.batch_size
    if horizon >= slots:
        raise ValueError(f"A horizon of {horizon} slots does not fit into trajectories of {slots}; take a shorter one.")
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.AdamW(predictor.parameters(), learning_rate, weight_decay=1e-4)
    schedule = warmup_cosine_schedule(optimizer, steps)
    progress = trange(steps, desc="refine predictor", unit="step")
    for _ in progress:
        episode = torch.randint(episodes, (batch_size, 1), generator=generator).to(embedding.device)
        start = torch.randint(slots - horizon, (batch_size, 1), generator=generator).to(embedding.device)
        start = start * (torch.rand(batch_size, 1, generator=generator) >= start_share).to(start)
        rows = start + torch.arange(horizon, device=embedding.device)
        with torch.autocast(embedding.device.type, precision):
            predicted = rollout(predictor, embedding[episode[:, 0], start[:, 0]], action[episode, rows])
        loss = cosine_loss(predicted, embedding[episode, rows + 1])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        progress.set_postfix(loss=f"{loss.item():.5f}", refresh=False)


class RefinePredictor(lightning.Callback):
    """Runs :func:`refine_predictor` when the fit ends, on the training split. List it before the export.

    Args: as of :func:`refine_predictor`.
    """

    def __init__(
        self,
        steps: int = 7000,
        horizon: int = 10,
        batch_size: int = 256,
        learning_rate: float = 2e-3,
        seed: int = 0,
        start_share: float = 0.0,
    ) -> None:
        self.steps, self.horizon, self.batch_size = steps, horizon, batch_size
        self.learning_rate, self.seed, self.start_share = learning_rate, seed, start_share

    def on_fit_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.is_global_zero:
            data = trainer.datamodule
            embedded = embed_split(module.encoder, data.split("train"), data.frame_spacing)
            refine_predictor(
                module.predictor,
                embedded,
                self.steps,
                self.horizon,
                self.batch_size,
                self.learning_rate,
                self.seed,
                self.start_share,
            )
