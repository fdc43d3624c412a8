"""A cart-pole whose pictures are the bytes of its state, and a model that reads them: right by construction."""

from dataclasses import replace

import numpy as np
import torch
from torch import nn

from tsjepa.models import SemanticController
from tsjepa.plants import CartPole

FRAME = (2, 4)  # 24 bytes, of which the state takes 16


class OpenPlant(CartPole):
    """Needs no GL."""

    def __init__(self, **settings) -> None:
        super().__init__(**settings)
        self.spec = replace(self.spec, frame=FRAME)

    def scene(self, physics, seed, device, episode):
        return physics.astype(np.float32)

    def render(self, scene):
        pictures = np.zeros((len(scene), FRAME[0] * FRAME[1] * 3), np.uint8)
        pictures[:, :16] = np.ascontiguousarray(scene, np.float32).view(np.uint8)
        return pictures.reshape(len(scene), *FRAME, 3)


def states_of(frames: torch.Tensor) -> torch.Tensor:
    """States [..., 4] from pictures uint8 [..., 2, 4, 3]."""
    return frames.flatten(-3)[..., :16].contiguous().view(torch.float32)


def lift(state: torch.Tensor) -> torch.Tensor:
    """Embeddings [..., 5] of unit length, the direction of (state, 1)."""
    return nn.functional.normalize(torch.cat((state, torch.ones_like(state[..., :1])), dim=-1), dim=-1)


def lower(embedding: torch.Tensor) -> torch.Tensor:
    """The states [..., 4] that :func:`lift` has lifted; 0 of an embedding of zeros, which stands for none."""
    return embedding[..., :4] / embedding[..., 4:].clamp_min(1e-6)


class Reader(nn.Module):
    """The state in the newest frame; it keeps every stack [N, kappa, 2, 4, 3] that it was given."""

    embedding_dim = 5

    def __init__(self, frame_stack: int) -> None:
        super().__init__()
        self.frame_shape = (frame_stack, *FRAME, 3)
        self.given = []

    def forward(self, frames):
        self.given.append(frames)
        return lift(states_of(frames[..., -1, :, :, :]))


class Exact(nn.Module):
    """The plant's own equations."""

    def __init__(self, plant) -> None:
        super().__init__()
        self.plant = plant

    def forward(self, embedding, command):
        state = lower(embedding)
        after = self.plant.stepper.advance(state.double().numpy(), command.double().numpy())
        return lift(torch.from_numpy(after).float())


class Expert(nn.Module):
    """The plant's first expert on what the embedding says."""

    def __init__(self, plant) -> None:
        super().__init__()
        self.law = next(iter(plant.experts().values()))

    def forward(self, embedding, reference=None):
        return self.law(lower(embedding), reference)


def right_model(plant: OpenPlant, spacing: int = 1, predicts: bool = True) -> SemanticController:
    """Two frames, of which it reads the newest; it predicts like the plant and acts like its first expert."""
    return SemanticController(Reader(2), Expert(plant), spacing, plant.spec, Exact(plant) if predicts else None)
