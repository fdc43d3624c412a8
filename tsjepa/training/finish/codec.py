"""Learns the ranges over which integer codecs send a model's embeddings, so that they travel with the model."""

from __future__ import annotations

from collections.abc import Sequence

import lightning
import torch

from tsjepa.radio.codecs import AffineCodec
from tsjepa.training.embeddings import embedded
from tsjepa.training.finish.callback import Finish


class FitCodec(Finish):
    """Sets ``code_low`` and ``code_high`` of the controller when the fit ends. List it before the export.

    They are the smallest and the largest value of each dimension over the splits, as :meth:`AffineCodec.fit` has them.

    Args:
        splits: of the data set.
    """

    def __init__(self, splits: Sequence[str] = ("train", "actor_train")) -> None:
        self.splits = tuple(splits)

    def finish(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        model, data = module.controller(), trainer.datamodule
        parts = [embedded(data, model, name)["embedding"].flatten(0, 1) for name in self.splits]
        codec = AffineCodec(model.embedding_dim).to(model.code_low.device).fit(torch.cat(parts))
        model.code_low.copy_(codec.low)
        model.code_high.copy_(codec.high)
