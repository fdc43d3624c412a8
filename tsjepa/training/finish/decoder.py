"""Fits the decoder on frozen embeddings when a fit ends, to see inside; nothing of it reaches the encoder."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext

import lightning
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn import functional as F

from tsjepa.data.frames import Frames
from tsjepa.models.decoder import Decoder
from tsjepa.models.encoder import patchify
from tsjepa.support.seeds import derive, run_seed
from tsjepa.training.embeddings import embedded
from tsjepa.training.finish.callback import Finish
from tsjepa.training.finish.minimize import ForwardContext, minimize

SMOOTHING = 17  # pixels, about the cart's width


class NewestFrames:
    """The newest frame of every stack of some splits, read from the memory map where it lies when it is asked for.

    Args:
        splits: [episodes, T + 1] with ``pixels``.
        first: first slot that has a whole stack behind it.
    """

    def __init__(self, splits: Sequence[TensorDictBase], first: int) -> None:
        self.pixels = Frames(splits)
        numbers = torch.arange(sum(split.batch_size.numel() for split in splits))
        parts = numbers.split([split.batch_size.numel() for split in splits])
        slots = [part.view(split.batch_size)[:, first:] for part, split in zip(parts, splits, strict=True)]
        self.number = torch.cat([part.flatten() for part in slots])

    def __len__(self) -> int:
        return len(self.number)

    def __getitem__(self, rows: Tensor) -> Tensor:
        """uint8 [N, H, W, 3] of the rows numbered [N]."""
        return self.pixels[self.number[rows]]


def fit_background(
    decoder: Decoder, frames: Tensor | Frames | NewestFrames, contrast_floor: float = 10.0, count: int = 500
) -> None:
    """Sets the decoder's background to the median frame, its contrast to how far frames are from it near that pixel.

    The contrast is smooth, because the decoder's convolutions draw a cart alike wherever it is.

    Args:
        decoder: of any number of frames, all of which get the same background.
        frames: uint8 [N, H, W, 3], of which at least ``count`` are looked at.
        contrast_floor: least contrast, of 255; a higher one lets rarely covered regions weigh less.
    """
    some = frames[torch.arange(0, len(frames), max(1, len(frames) // count))].to(decoder.background.device)
    background = some.median(0).values
    squares = torch.stack([(frame.float() - background).square().mean(-1) for frame in some]).mean(0)
    around = F.avg_pool2d(squares[None, None], SMOOTHING, 1, SMOOTHING // 2, count_include_pad=False)[0, 0]
    contrast = around.sqrt().clamp_min(contrast_floor)[..., None].expand_as(background)
    for buffer, frame in ((decoder.background, background), (decoder.contrast, contrast)):
        buffer.copy_(patchify(frame.expand(1, decoder.frame_stack, *frame.shape))[0])
    decoder.fitted.fill_(True)


class MeanSquare(torch.autograd.Function):
    """Mean square of a tensor.

    On 16-bit tensors on a CPU it takes half of ``F.mse_loss``'s time, and there are more numbers here than in a layer.
    """

    @staticmethod
    def forward(context, error: Tensor) -> Tensor:
        context.save_for_backward(error)
        return torch.linalg.vector_norm(error, dtype=torch.float32).square() / error.numel()

    @staticmethod
    def backward(context, gradient: Tensor) -> Tensor:
        (error,) = context.saved_tensors
        return error * (2 * gradient / error.numel()).to(error.dtype)


def reconstruction_loss(decoder: Decoder, drawn: Tensor, patches: Tensor, motion_weight: float = 0.0) -> Tensor:
    """Mean squared error of what ``decoder`` has drawn, in units of contrast.

    Neighbouring frames are so alike that their velocities hardly count in the error of the frames themselves.

    Args:
        decoder: whose background and contrast count.
        drawn: [N, H / 4, W / 4, channels], what :meth:`Decoder.draw` gave.
        patches: the true frames in the same shape, in 0..255 and of any dtype.
        motion_weight: of the mean squared error of the differences between each frame and the one before it, if any.
    """
    scale = 1 / decoder.contrast
    shift = -decoder.background * scale
    target = torch.addcmul(shift.to(drawn.dtype), patches.to(drawn.dtype), scale.to(drawn.dtype))
    error = drawn - target
    loss = MeanSquare.apply(error)
    if motion_weight and decoder.frame_stack > 1:
        frame = error.shape[-1] // decoder.frame_stack
        loss = loss + motion_weight * MeanSquare.apply(error[..., frame:] - error[..., :-frame])
    return loss


def fit_decoder(
    decoder: Decoder,
    embedding: Tensor,
    frames: Tensor | NewestFrames,
    steps: int,
    batch_size: int = 128,
    learning_rate: float = 3e-3,
    seed: int = 0,
    forward_context: ForwardContext = nullcontext,
) -> None:
    """Trains the decoder in place on :func:`reconstruction_loss` and leaves it in evaluation mode.

    Args:
        decoder: of one frame.
        embedding: [N, d].
        frames: uint8 [N, H, W, 3], the newest frame of each embedding; may lie on another device.
        steps, batch_size, learning_rate: of AdamW with warm-up and cosine decay.
        seed: seed of the batches.
        forward_context: the precision of the drawing.
    """
    device = embedding.device
    fit_background(decoder, frames)
    generator = torch.Generator().manual_seed(seed)

    def loss() -> Tensor:
        rows = torch.randint(len(embedding), (batch_size,), generator=generator)
        patches = patchify(frames[rows].to(device)[:, None])
        with forward_context():
            drawn = decoder.draw(embedding[rows.to(device)])
        return reconstruction_loss(decoder, drawn, patches)

    decoder.train()
    minimize(loss, decoder.parameters(), steps, learning_rate, 1e-4, "fit decoder")
    decoder.eval()


class FitDecoder(Finish):
    """Runs :func:`fit_decoder` on the controller's decoder when the fit ends. List it before the export.

    Args:
        steps: optimizer steps.
        batch_size: frames a step.
        splits: of the data set.
    """

    def __init__(self, steps: int = 1500, batch_size: int = 128, splits: Sequence[str] = ("train",)) -> None:
        self.steps, self.batch_size, self.splits = steps, batch_size, tuple(splits)

    def finish(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        model, data = module.controller(), trainer.datamodule
        parts = [embedded(data, model, name)["embedding"] for name in self.splits]
        splits = [data.split(name) for name in self.splits]
        first = splits[0].shape[1] - parts[0].shape[1]
        fit_decoder(
            model.decoder,
            torch.cat([rows.flatten(0, 1) for rows in parts]),
            NewestFrames(splits, first),
            self.steps,
            self.batch_size,
            seed=derive(run_seed(), "decoder"),
            forward_context=trainer.precision_plugin.forward_context,
        )
