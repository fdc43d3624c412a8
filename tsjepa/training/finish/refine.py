"""Finishes the predictor on the frozen encoder's embeddings, where a step costs a hundredth of one through it."""

from __future__ import annotations

from contextlib import nullcontext

import lightning
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from tsjepa.models.predictor import rollout
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.embeddings import embed_split
from tsjepa.training.finish.callback import Finish
from tsjepa.training.finish.minimize import ForwardContext, minimize
from tsjepa.training.losses import cosine_loss


def refine_predictor(
    predictor: nn.Module,
    embedded: TensorDictBase,
    steps: int,
    horizon: int,
    batch_size: int,
    learning_rate: float,
    seed: int,
    start_share: float = 0.0,
    starts: TensorDictBase | None = None,
    forward_context: ForwardContext = nullcontext,
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
        starts: many short trajectories [episodes, slots], from anywhere in which that share is taken instead: a
            predictor of 256 numbers learns the few starts of ``embedded`` by heart.
        forward_context: the precision of the roll-outs.
    """
    for part in (embedded, starts):
        if part is not None:
            check_horizon(horizon, part.shape[1])
    generator = torch.Generator().manual_seed(seed)

    def loss() -> Tensor:
        if starts is None:
            embedding, action = draw(embedded, batch_size, horizon, generator, start_share)
        else:
            short = round(start_share * batch_size)
            parts = (draw(embedded, batch_size - short, horizon, generator), draw(starts, short, horizon, generator))
            embedding, action = (torch.cat(pair) for pair in zip(*parts, strict=True))
        with forward_context():
            predicted = rollout(predictor, embedding[:, 0], action)
        return cosine_loss(predicted, embedding[:, 1:])

    minimize(loss, predictor.parameters(), steps, learning_rate, 1e-4, "refine predictor")


def check_horizon(horizon: int, slots: int) -> None:
    """ValueError unless roll-outs over ``horizon`` slots fit into trajectories of ``slots`` embeddings."""
    if horizon >= slots:
        raise ValueError(f"A horizon of {horizon} slots does not fit into trajectories of {slots}; take a shorter one.")


def draw(
    embedded: TensorDictBase, count: int, horizon: int, generator: torch.Generator, start_share: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Embeddings [count, horizon + 1, d] and commands [count, horizon, m] of roll-outs that begin anywhere, or, as
    many as ``start_share`` says, where a trajectory begins."""
    embedding, action = embedded["embedding"], embedded["action"]
    episodes, slots = embedded.batch_size
    episode = torch.randint(episodes, (count, 1), generator=generator).to(embedding.device)
    start = torch.randint(slots - horizon, (count, 1), generator=generator).to(embedding.device)
    start = start * (torch.rand(count, 1, generator=generator) >= start_share).to(start)
    rows = start + torch.arange(horizon + 1, device=embedding.device)
    return embedding[episode, rows], action[episode, rows[:, :-1]]


class RefinePredictor(Finish):
    """Runs :func:`refine_predictor` when the fit ends, on the data module's training splits. List it before the export.

    Args:
        steps, horizon, batch_size, learning_rate, start_share: as of :func:`refine_predictor`.
        starts: split of many short trajectories from which ``start_share`` of the roll-outs is taken; None for the
            starts of the training splits.
    """

    def __init__(
        self,
        steps: int = 7000,
        horizon: int = 10,
        batch_size: int = 256,
        learning_rate: float = 2e-3,
        start_share: float = 0.0,
        starts: str | None = None,
    ) -> None:
        self.steps, self.horizon, self.batch_size = steps, horizon, batch_size
        self.learning_rate, self.start_share, self.starts = learning_rate, start_share, starts

    def on_fit_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        data = trainer.datamodule  # what is wrong with its trajectories is told before the fit
        for name in (*data.splits, *([self.starts] if self.starts else [])):
            check_horizon(self.horizon, data.split(name).shape[1] - data.first_slot)

    def finish(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        data = trainer.datamodule

        def embedded(*names: str) -> TensorDictBase:
            return torch.cat([embed_split(module.encoder, data.split(name), data.frame_spacing) for name in names])

        refine_predictor(
            module.predictor,
            embedded(*data.splits),
            self.steps,
            self.horizon,
            self.batch_size,
            self.learning_rate,
            derive(run_seed(), "refine"),
            self.start_share,
            embedded(self.starts) if self.starts else None,
            trainer.precision_plugin.forward_context,
        )
