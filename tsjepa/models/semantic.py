"""Everything that runs in the loop, in one module: what the zoo ships and what the evaluation drives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from tsjepa.models.actor import Actor
from tsjepa.models.decoder import Decoder
from tsjepa.models.encoder import Encoder
from tsjepa.models.hub import HubModel
from tsjepa.models.predictor import Predictor
from tsjepa.models.probe import StateProbe


@dataclass
class Architecture:
    """Sizes that rebuild a :class:`SemanticController`; the fields are the arguments of its parts.

    Without ``has_predictor`` it is a controller that holds its last command between updates (the supervised baseline).
    """

    frame_stack: int = 2
    frame_spacing: int = 1
    widths: tuple[int, int, int] = (64, 128, 256)
    embedding_dim: int = 256
    predictor_hidden_dim: int = 1024
    predictor_residual: bool = True
    actor_hidden_dims: tuple[int, int] = (1024, 256)
    sampling_interval: float = 0.02
    has_predictor: bool = True


class SemanticController(HubModel, nn.Module):
    """Context encoder (on the device), predictor and semantic actor (at the controller).

    Two more parts look inside and control nothing: ``probe`` reads the state from an embedding, ``decoder`` draws it.

    Args:
        architecture: sizes of the parts. ``frame_spacing`` is how many slots lie between the frames of a stack and
            ``sampling_interval`` the slot in seconds; both belong to how the weights were trained.
        actor_dropout: only matters while the actor is trained.

    ``code_low`` and ``code_high`` [d] are the ranges over which an integer codec sends an embedding; NaN until
    :class:`tsjepa.training.finish.codec.FitCodec` has set them.
    """

    def __init__(self, architecture: Architecture, actor_dropout: float = 0.0) -> None:
        super().__init__()
        dim = architecture.embedding_dim
        self.architecture = architecture
        self.encoder = Encoder(architecture.frame_stack, architecture.widths, dim)
        self.predictor = None
        if architecture.has_predictor:
            self.predictor = Predictor(dim, architecture.predictor_hidden_dim, architecture.predictor_residual)
        self.actor = Actor(dim, architecture.actor_hidden_dims, actor_dropout)
        self.probe = StateProbe(dim)
        self.decoder = Decoder(dim)
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
        """Embedding [..., d] one slot later under ``command`` [..., 1] in newtons.

        Raises:
            ValueError: this controller has no predictor.
        """
        if self.predictor is None:
            raise ValueError("This controller has no predictor (has_predictor is False); hold the last command.")
        return self.predictor(embedding, command)

    def act(self, embedding: Tensor) -> Tensor:
        """Command [..., 1] in newtons for ``embedding`` [..., d]."""
        return self.actor(embedding)

    def decode(self, embedding: Tensor) -> Tensor:
        """Newest frame of an embedding [..., d] as the decoder draws it: float [..., H, W, 3] in 0..255.

        Raises:
            ValueError: the decoder was never trained.
        """
        return self.decoder(embedding)[..., -1, :, :, :]
