"""Embeds pictures for training and whole trajectories for what is fitted on a frozen encoder."""

from __future__ import annotations

import lightning
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from tsjepa.data.frames import Frames
from tsjepa.models import Controller
from tsjepa.models.encoder import PIXEL_MEAN, PIXEL_STD, unpatchify

CARRIED = ("state", "action", "expert_action", "reference")  # beside the embeddings, where a split has them


def embed_patches(encoder: nn.Module, patches: Tensor) -> Tensor:
    """Embeddings [N, d] of augmented, normalised patches [N, H / 4, W / 4, 48 * frame_stack].

    An encoder without ``embed`` gets the pictures as it gets them in use: uint8 [N, frame_stack, H, W, 3].
    """
    if hasattr(encoder, "embed"):
        return encoder.embed(patches)
    frames = unpatchify(patches.float())
    mean, std = (torch.tensor(values, device=frames.device) for values in (PIXEL_MEAN, PIXEL_STD))
    return encoder(((frames * std + mean) * 255).round().clamp(0, 255).to(torch.uint8)).float()


@torch.no_grad()
def embed_split(encoder: nn.Module, split: TensorDictBase, frame_spacing: int, batch: int = 256) -> TensorDict:
    """Embeds every slot of a split that has a whole stack behind it.

    Args:
        encoder: put into evaluation mode for the time of the call.
        split: [episodes, T + 1] with ``pixels``, and what it has of :data:`CARRIED`.
        frame_spacing: slots between the frames of a stack.
        batch: stacks per forward pass.

    Returns:
        [episodes, T + 1 - first] with ``embedding`` [d] and what was carried, on the encoder's device.
    """
    weight = next(encoder.parameters(), None)  # none where an encoder is a graph of elsewhere
    device = torch.device("cpu") if weight is None else weight.device
    stack = encoder.frame_shape[0]
    first = (stack - 1) * frame_spacing
    episodes, frames = split.batch_size
    pixels = Frames([split])
    newest = (frames * torch.arange(episodes)[:, None] + torch.arange(first, frames)).flatten()
    offsets = frame_spacing * torch.arange(1 - stack, 1)
    was_training = encoder.training
    encoder.eval()
    parts = [encoder(pixels[rows[:, None] + offsets].to(device)).float() for rows in newest.split(batch)]
    encoder.train(was_training)
    embedding = torch.cat(parts).unflatten(0, (episodes, frames - first))
    rest = split.select(*CARRIED, strict=False)[:, first:].to(device)
    return TensorDict({"embedding": embedding, **rest}, batch_size=[episodes, frames - first], device=device)


def embedded(data: lightning.LightningDataModule, model: Controller, name: str) -> TensorDict:
    """A split by :func:`embed_split`, or as the data module has embedded it for the same frozen encoder."""
    kept = getattr(data, "embedded", {})
    return kept[name] if name in kept else embed_split(model.encoder, data.split(name), model.frame_spacing)


def commands_to_imitate(rows: TensorDictBase) -> Tensor:
    """The expert's commands [..., m], or those that were recorded where no expert labelled them."""
    return rows.get("expert_action", rows["action"])
