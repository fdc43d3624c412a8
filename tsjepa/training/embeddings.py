"""Embeds whole trajectories with a frozen encoder, for probes, actors and metrics."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase

from tsjepa.models import Encoder


@torch.no_grad()
def embed_split(encoder: Encoder, split: TensorDictBase, frame_spacing: int, batch: int = 256) -> TensorDict:
    """Embeds every slot of a split that has a whole stack behind it.

    Args:
        encoder: put into evaluation mode for the time of the call.
        split: [episodes, T + 1] with ``pixels``, ``state``, ``action``, ``expert_action``.
        frame_spacing: slots between the frames of a stack.
        batch: stacks per forward pass.

    Returns:
        [episodes, T + 1 - first] with ``embedding`` [d], ``state``, ``action``, ``expert_action``, on the encoder's
        device.
    """
    device = next(encoder.parameters()).device
    stack = encoder.frame_shape[0]
    first = (stack - 1) * frame_spacing
    episodes, frames = split.batch_size
    pixels = torch.from_numpy(split["pixels"].cpu().numpy()).flatten(0, 1)
    newest = (frames * torch.arange(episodes)[:, None] + torch.arange(first, frames)).flatten()
    offsets = frame_spacing * torch.arange(1 - stack, 1)
    was_training = encoder.training
    encoder.eval()
    parts = [encoder(pixels[rows[:, None] + offsets].to(device)) for rows in newest.split(batch)]
    encoder.train(was_training)
    embedding = torch.cat(parts).unflatten(0, (episodes, frames - first))
    rest = split.select("state", "action", "expert_action")[:, first:].to(device)
    return TensorDict({"embedding": embedding, **rest}, batch_size=[episodes, frames - first], device=device)
