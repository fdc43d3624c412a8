"""Fits the decoder on frozen embeddings when a fit ends, to see inside; nothing of it reaches the encoder."""

from __future__ import annotations

from collections.abc import Sequence

import lightning
import torch
from torch import Tensor
from tqdm import trange

from tsjepa.models.decoder import Decoder
from tsjepa.models.encoder import patchify
from tsjepa.training.embeddings import embed_split
from tsjepa.training.schedule import warmup_cosine_schedule

FOREGROUND_WEIGHT = 20.0


def median_frame(frames: Tensor, count: int = 301) -> Tensor:
    """Median of ``count`` of the ``frames`` uint8 [N, H, W, 3], as patches [H / 4, W / 4, 48] for the background."""
    some = frames[:: max(1, len(frames) // count)]
    return patchify(some.median(0).values[None, None])[0].float()


def reconstruction_loss(drawn: Tensor, patches: Tensor, backdrop: Tensor, foreground_weight: float) -> Tensor:
    """Mean squared error of what is drawn over the background, cart and pole weighing more than the rest.

    They cover a few per cent of the picture. Every value is weighted by 1 + ``foreground_weight`` times its distance to
    the background, of 255.

    Args:
        drawn: [N, H / 4, W / 4, channels], what :meth:`Decoder.draw` gives.
        patches: uint8, the true frames in the same shape.
        backdrop: [H / 4, W / 4, channels] in 0..255.
        foreground_weight: 0 weighs all alike.
    """
    deviation = (patches.to(drawn.dtype) - backdrop.to(drawn.dtype)) / 255
    weight = 1 + foreground_weight * deviation.abs()
    return (weight * (drawn - deviation).square()).mean(dtype=torch.float32)


def fit_decoder(
    decoder: Decoder,
    embedding: Tensor,
    frames: Tensor,
    steps: int,
    batch_size: int = 128,
    learning_rate: float = 3e-3,
    foreground_weight: float = FOREGROUND_WEIGHT,
    seed: int = 0,
    precision: torch.dtype = torch.bfloat16,
) -> None:
    """Trains the decoder in place on :func:`reconstruction_loss` and leaves it in evaluation mode.

    Args:
        decoder: of one frame; its ``background`` becomes the median frame.
        embedding: [N, d].
        frames: uint8 [N, H, W, 3], the newest frame of each embedding; may lie on another device.
        steps, batch_size, learning_rate: of AdamW with warm-up and cosine decay.
        foreground_weight: see :func:`reconstruction_loss`.
        seed: seed of the batches.
        precision: autocast dtype of the forward pass.
    """
    device = embedding.device
    decoder.background.copy_(median_frame(frames))
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.AdamW(decoder.parameters(), learning_rate, weight_decay=1e-4)
    schedule = warmup_cosine_schedule(optimizer, steps)
    decoder.train()
    progress = trange(steps, desc="fit decoder", unit="step")
    for _ in progress:
        rows = torch.randint(len(embedding), (batch_size,), generator=generator)
        patches = patchify(frames[rows].to(device)[:, None])
        with torch.autocast(device.type, precision):
            drawn = decoder.draw(embedding[rows.to(device)])
        loss = reconstruction_loss(drawn, patches, decoder.backdrop(), foreground_weight)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        progress.set_postfix(loss=f"{loss.item():.5f}", refresh=False)
    decoder.eval()
    decoder.fitted.fill_(True)


class FitDecoder(lightning.Callback):
    """Runs :func:`fit_decoder` on the controller's decoder when the fit ends. List it before the export.

    Args:
        steps: optimizer steps.
        batch_size: frames a step.
        splits: of the data set.
    """

    def __init__(self, steps: int = 1500, batch_size: int = 128, splits: Sequence[str] = ("train",)) -> None:
        self.steps, self.batch_size, self.splits = steps, batch_size, tuple(splits)

    def on_fit_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if not trainer.is_global_zero:
            return
        model, data = module.controller(), trainer.datamodule
        # Lightning has already moved everything back to the CPU
        home, device = next(model.decoder.parameters()).device, trainer.strategy.root_device
        model.to(device)
        embeddings, frames = [], []
        for split in map(data.split, self.splits):
            embedded = embed_split(model.encoder, split, model.architecture.frame_spacing)["embedding"]
            newest = torch.from_numpy(split["pixels"].numpy())[:, -embedded.shape[1] :]
            embeddings.append(embedded.flatten(0, 1))
            frames.append(newest.flatten(0, 1))
        fit_decoder(model.decoder, torch.cat(embeddings), torch.cat(frames), self.steps, self.batch_size)
        model.to(home)
