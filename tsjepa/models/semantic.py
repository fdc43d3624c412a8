"""Everything that runs in the loop, in one module: what the zoo ships and what the evaluation drives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from tsjepa.models.actor import Actor
from tsjepa.models.encoder import Encoder
from tsjepa.models.predictor import Predictor
from tsjepa.models.probe import StateProbe


@dataclass
class Architecture:
    """Sizes that rebuild a :class:`SemanticController`; the fields are the arguments of its parts."""

    frame_stack: int = 2
    frame_spacing: int = 1
    widths: tuple[int, int, int] = (64, 128, 256)
    embedding_dim: int = 256
    predictor_hidden_dim: int = 1024
    predictor_residual: bool = True
    actor_hidden_dims: tuple[int, int] = (1024, 256)
    sampling_interval: float = 0.02


class SemanticController(nn.Module):
    """Context encoder (on the device), predictor, semantic actor and state probe (at the controller).

    Args:
        architecture: sizes of the parts. ``frame_spacing`` is how many slots lie between the frames of a stack and
            ``sampling_interval`` the slot in seconds; both belong to how the weights were trained.
        actor_dropout: only matters while the actor is trained.

    ``code_low`` and ``code_high`` [d] are the ranges over which an integer codec sends an embedding; NaN until
    :class:`tsjepa.training.codec.FitCodec` has set them.
    """

    def __init__(self, architecture: Architecture, actor_dropout: float = 0.0) -> None:
        super().__init__()
        dim = architecture.embedding_dim
        self.architecture = architecture
        self.encoder = Encoder(architecture.frame_stack, architecture.widths, dim)
        self.predictor = Predictor(dim, architecture.predictor_hidden_dim, architecture.predictor_residual)
        self.actor = Actor(dim, architecture.actor_hidden_dims, actor_dropout)
        self.probe = StateProbe(dim)
        self.register_buffer("code_low", torch.full((dim,), math.nan))
        self.register_buffer("code_high", torch.full((dim,), math.nan))

    @property
    def frame_history(self) -> int:
        """Slots that one stack spans."""
        return (self.architecture.frame_stack - 1) * self.architecture.frame_spacing + 1

    def encode(self, frames: Tensor) -> Tensor:
        """uint8 [..., frame_stack, H, W, 3], oldest first, to embeddings [..., d] of unit length."""
        return self.encoder(frames)

    def predict(self, embedding: Tensor, command: Tensor) -> Tensor:
        """Embedding [..., d] one slot later under ``command`` [..., 1] in newtons."""
        return self.predictor(embedding, command)

    def act(self, embedding: Tensor) -> Tensor:
        """Command [..., 1] in newtons for ``embedding`` [..., d]."""
        return self.actor(embedding)
