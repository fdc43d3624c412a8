"""What an encoder of the user's own has to be, said before it is trained."""

from __future__ import annotations

import torch
from torch import nn

from tsjepa.support.description import describe

OFF_UNIT = 0.01  # of an embedding's length, which half precision may cost


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
        ValueError: see :func:`check_sizes_of`, an argument of its constructor is not kept, or its embeddings are not
            [N, d], finite and of unit length.
    """
    check_sizes_of(encoder)
    describe(encoder, lambda kind: issubclass(kind, nn.Module))
    name, shape = type(encoder).__name__, (2, *encoder.frame_shape)
    frames = (torch.arange(torch.Size(shape).numel()) % 251).to(torch.uint8).reshape(shape)
    tensor = next(encoder.parameters(), None)
    was_training = encoder.training
    encoder.eval()
    embedding = encoder(frames if tensor is None else frames.to(tensor.device))
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


def _counts(number: object) -> bool:
    return isinstance(number, int) and number >= 1
