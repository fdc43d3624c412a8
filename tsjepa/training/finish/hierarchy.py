"""Trains a predictor's strides on the frozen encoder's embeddings, so that they agree where they meet."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext

import lightning
import torch
from tensordict import TensorDictBase
from torch import Tensor

from tsjepa.models.hierarchy import HierarchicalPredictor
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.embeddings import embed_split
from tsjepa.training.finish.callback import Finish
from tsjepa.training.finish.minimize import ForwardContext, minimize
from tsjepa.training.finish.refine import draw
from tsjepa.training.losses import cosine_loss


def fit_hierarchy(
    predictor: HierarchicalPredictor,
    embedded: TensorDictBase,
    steps: int,
    jumps: Sequence[int],
    batch_size: int,
    learning_rate: float,
    seed: int,
    start_share: float = 0.0,
    consistency_weight: float = 0.5,
    forward_context: ForwardContext = nullcontext,
) -> None:
    """Trains every stride in place: the cosine loss over its own jumps, and over what two strides say of one slot.

    Args:
        predictor: with its strides.
        embedded: [episodes, slots] with ``embedding`` and ``action``.
        steps: optimizer steps.
        jumps: in a row, of each stride.
        batch_size: roll-outs per step.
        learning_rate: peak of AdamW's warm-up and cosine decay.
        seed: of the roll-outs' starts.
        start_share: as of :func:`tsjepa.training.finish.refine.refine_predictor`.
        consistency_weight: of the disagreement between neighbouring strides.
        forward_context: the precision of the roll-outs.

    Raises:
        ValueError: not a number of jumps for each stride, or more slots than the trajectories have.
    """
    strides = predictor.strides
    if len(jumps) != len(strides) or min(jumps) < 1:
        raise ValueError(f"jumps {list(jumps)} must be at least 1 for each of the strides {list(strides)}.")
    horizon = max(count * stride for count, stride in zip(jumps, strides, strict=True))
    if horizon >= embedded.shape[1]:
        raise ValueError(
            f"Jumps {list(jumps)} of {list(strides)} slots do not fit into trajectories of {embedded.shape[1]}; take "
            "fewer."
        )
    generator = torch.Generator().manual_seed(seed)

    def loss() -> Tensor:
        embedding, action = draw(embedded, batch_size, horizon, generator, start_share)
        with forward_context():
            told = [
                predictor.jumps(level, embedding[:, 0], action[:, : count * stride])
                for level, (count, stride) in enumerate(zip(jumps, strides, strict=True))
            ]
        errors = [
            cosine_loss(predicted, embedding[:, stride : stride * predicted.shape[1] + 1 : stride])
            for predicted, stride in zip(told, strides, strict=True)
        ]
        return torch.stack(errors).mean() + consistency_weight * disagreement(told, strides)

    minimize(loss, predictor.parameters(), steps, learning_rate, 1e-4, "fit hierarchy")


def disagreement(told: Sequence[Tensor], strides: Sequence[int]) -> Tensor:
    """Mean 1 - cosine between the predictions [N, jumps, d] of neighbouring strides, in the slots that both reach."""
    apart = []
    for fine, coarse, small, large in zip(told, told[1:], strides, strides[1:], strict=False):
        every = large // small
        meeting = fine[:, every - 1 :: every]
        common = min(meeting.shape[1], coarse.shape[1])
        if common:
            apart.append(cosine_loss(meeting[:, :common], coarse[:, :common]))
    return torch.stack(apart).mean() if apart else told[0].new_zeros(())


class FitHierarchy(Finish):
    """Runs :func:`fit_hierarchy` when the fit ends, on the data module's training splits. List it before the export.

    Args:
        steps, jumps, batch_size, learning_rate, start_share, consistency_weight: as of :func:`fit_hierarchy`.
    """

    def __init__(
        self,
        steps: int = 3000,
        jumps: Sequence[int] = (10, 8, 2),
        batch_size: int = 256,
        learning_rate: float = 2e-3,
        start_share: float = 0.0,
        consistency_weight: float = 0.5,
    ) -> None:
        self.steps, self.jumps, self.batch_size = steps, tuple(jumps), batch_size
        self.learning_rate, self.start_share = learning_rate, start_share
        self.consistency_weight = consistency_weight

    def on_fit_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if not isinstance(module.predictor, HierarchicalPredictor):
            raise ValueError(
                f"FitHierarchy trains a HierarchicalPredictor, and this fit has a {type(module.predictor).__name__}: "
                "name that class as the predictor, or leave the callback out."
            )

    def finish(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        data = trainer.datamodule
        splits = [embed_split(module.encoder, data.split(name), data.frame_spacing) for name in data.splits]
        fit_hierarchy(
            module.predictor,
            torch.cat(splits),
            self.steps,
            self.jumps,
            self.batch_size,
            self.learning_rate,
            # RefinePredictor's stream, for this takes its place, so that the two can be compared: of one seed and batch
            # size both draw the same trajectories, and the same ones from their starts. Where within the others a
            # roll-out begins differs with the horizon.
            derive(run_seed(), "refine"),
            self.start_share,
            self.consistency_weight,
            trainer.precision_plugin.forward_context,
        )
