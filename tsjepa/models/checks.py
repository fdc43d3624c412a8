"""What an encoder of the user's own has to be, said before it is trained."""

from __future__ import annotations

import torch
from torch import nn

from tsjepa.models.encoder import PATCH, PIXEL_MEAN, PIXEL_STD, patchify
from tsjepa.support.description import describe

OFF_UNIT = 0.01  # of an embedding's length, which half precision may cost
OFF_ANOTHER = 0.05  # between the embeddings of one stack from its frames and from its patches


def check_sizes_of(encoder: nn.Module) -> None:
    """Refuses an encoder that does not say what it takes and gives.

    Raises:
        ValueError: ``frame_shape`` is not (frame_stack, H, W, 3), or ``embedding_dim`` no number of at least 1.
    """
    name = type(encoder).__name__
    shape, dim = getattr(encoder, "frame_shape", None), getattr(encoder, "embedding_dim", None)
    if not (isinstance(shape, (tuple, list)) and len(shape) == 4 and all(_counts(side) for side in shape)):
        raise ValueError(
            f"The encoder {name} has the frame_shape {shape}; set self.frame_shape = (frame_stack, height, width, 3), "
            "such as (2, 64, 128, 3), in its constructor."
        )
    if not _counts(dim):
        raise ValueError(
            f"The encoder {name} has the embedding_dim {dim}; set self.embedding_dim in its constructor to how many "
            "numbers an embedding has."
        )


@torch.no_grad()
def check_encoder(encoder: nn.Module) -> None:
    """Refuses an encoder that cannot be trained or stored, by embedding two stacks of frames, without a random number.

    Raises:
        ValueError: see :func:`check_sizes_of`, an argument of its constructor is not kept, its embeddings are not
            [N, d], finite and of unit length, or an ``embed`` of its own gives others.
    """
    check_sizes_of(encoder)
    describe(encoder, lambda kind: issubclass(kind, nn.Module))
    name, shape = type(encoder).__name__, (2, *encoder.frame_shape)
    frames = (torch.arange(torch.Size(shape).numel()) % 251).to(torch.uint8).reshape(shape)
    tensor = next(encoder.parameters(), None)
    was_training = encoder.training
    encoder.eval()
    frames = frames if tensor is None else frames.to(tensor.device)
    embedding = encoder(frames)
    from_patches = encoder.embed(_patches(encoder, frames)) if hasattr(encoder, "embed") else embedding
    encoder.train(was_training)
    wanted = [2, encoder.embedding_dim]
    if not isinstance(embedding, torch.Tensor) or list(embedding.shape) != wanted:
        given = list(embedding.shape) if isinstance(embedding, torch.Tensor) else f"a {type(embedding).__name__}"
        raise ValueError(
            f"The encoder {name} gives {given} for 2 stacks of frames; embeddings are {wanted}, as its embedding_dim "
            "says: give its last layer that many numbers, or set embedding_dim to those that it has."
        )
    lengths = embedding.float().norm(dim=-1)
    if not bool(((lengths - 1).abs() <= OFF_UNIT).all()):
        raise ValueError(
            f"The encoder {name} gives embeddings of lengths {lengths[0]:.3g} and {lengths[1]:.3g}, which have to be "
            "1: end its forward with torch.nn.functional.normalize(embedding, dim=-1)."
        )
    if not isinstance(from_patches, torch.Tensor) or from_patches.shape != embedding.shape:
        given = list(from_patches.shape) if isinstance(from_patches, torch.Tensor) else type(from_patches).__name__
        raise ValueError(f"embed of the encoder {name} gives {given} for 2 stacks of patches, its forward {wanted}.")
    apart = (from_patches.float() - embedding.float()).norm(dim=-1).max()
    if not bool(apart <= OFF_ANOTHER):
        raise ValueError(
            f"embed of the encoder {name} gives embeddings that are {apart:.3g} from those of its forward for the same "
            "frames, so that others are trained than are used: let forward normalise, patchify and call embed."
        )


def _patches(encoder: nn.Module, frames: torch.Tensor) -> torch.Tensor:
    """What an encoder's ``embed`` gets of ``frames`` where nothing is augmented."""
    mean, std = (torch.tensor(values, device=frames.device) for values in (PIXEL_MEAN, PIXEL_STD))
    colors = (frames / 255 - mean) / std
    mix = getattr(encoder, "color_mix", None)
    colors = colors if mix is None else colors @ mix.to(colors).mT
    if any(side % PATCH for side in frames.shape[2:4]):
        raise ValueError(
            f"The encoder {type(encoder).__name__} has embed, which gets patches of {PATCH} x {PATCH} pixels, and "
            f"frames of {frames.shape[2]} x {frames.shape[3]}: make the sides multiples of {PATCH}, or leave embed out."
        )
    return patchify(colors)


def _counts(number: object) -> bool:
    return isinstance(number, int) and number >= 1
