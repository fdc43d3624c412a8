"""Takes the mean out of a trained encoder's embeddings, so that a cosine looks at what varies."""

from __future__ import annotations

import lightning
import torch
from tensordict import TensorDictBase
from torch import nn

from tsjepa.training.embeddings import embed_split
from tsjepa.training.finish.callback import Finish


@torch.no_grad()
def centre_embedding(encoder: nn.Module, split: TensorDictBase, frame_spacing: int) -> None:
    """Shifts the encoder's last bias so that its output before normalisation has mean zero over ``split``.

    A trained encoder puts much of every embedding into one common direction. The cosine loss then spends itself there,
    and predictions under opposite forces look alike. Centring while training is worse: that lifts unpredictable
    directions.

    Args:
        encoder: with a last layer ``project`` that has a bias; changed in place. Whatever reads its embeddings has to
            be trained after this.
        split: [episodes, T + 1] with ``pixels``.
        frame_spacing: slots between the frames of a stack.
    """
    sums, count = [], 0

    def collect(module, inputs, output) -> None:
        nonlocal count
        sums.append(output.double().sum(0))
        count += len(output)

    hook = encoder.project.register_forward_hook(collect)
    embed_split(encoder, split, frame_spacing)
    hook.remove()
    encoder.project.bias -= (torch.stack(sums).sum(0) / count).to(encoder.project.bias)


class CentreEmbedding(Finish):
    """Runs :func:`centre_embedding` when the fit ends; list it before ``RefinePredictor``.

    On every fourth trajectory of the training split: the mean needs no more, and to embed all takes as long as 50
    steps.

    An encoder without a last layer ``project`` that has a bias stays as it is, and that is said.
    """

    def finish(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        data = trainer.datamodule
        if getattr(getattr(module.encoder, "project", None), "bias", None) is None:
            kind = type(module.encoder).__name__
            print(f"The embeddings are not centred: {kind} has no last layer named project that has a bias.")
            return
        centre_embedding(module.encoder, data.split("train")[::4], data.frame_spacing)
