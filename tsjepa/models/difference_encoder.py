"""A context encoder for still cameras: what is where in the newest frame, and what has moved since the older ones."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.encoder import PatchEncoder
from tsjepa.support.checks import at_least


class DifferenceEncoder(PatchEncoder):
    """One linear map of the newest frame and of its differences to the older ones, then a residual MLP.

    A velocity moves an edge by tenths of a pixel between frames, which a network over stacked frames finds only after
    long training. Features of single frames, of which the newest and their changes are passed on, show it at once
    (latent flow; Shang et al., "Reinforcement Learning with Latent Flow", 2021). With a linear map the change of the
    features is the map of the change of the pixels. That is exact, where the difference of two features in bfloat16 is
    mostly rounding. Every output of the map weighs all pixels, so centres of mass, which are linear in the pixels, cost
    nothing to find; in exchange nothing is shared between places, and a camera that moves is not forgiven.

    Args:
        frame_stack: frames per embedding (kappa of the paper), oldest first.
        embedding_dim: d.
        height, width: of a frame in pixels, multiples of 4.
        features: numbers in which the map describes a frame, or a difference.
        hidden_dim: width of the MLP.
        grey: read the luma of every pixel instead of its three colours.
    """

    def __init__(
        self,
        frame_stack: int = 2,
        embedding_dim: int = 64,
        height: int = 64,
        width: int = 128,
        features: int = 256,
        hidden_dim: int = 512,
        grey: bool = True,
    ) -> None:
        super().__init__(frame_stack, embedding_dim, height, width, grey)
        at_least(1, features=features, hidden_dim=hidden_dim)
        self.features, self.hidden_dim = features, hidden_dim
        pixels = height * width * (1 if grey else 3)
        self.describe = nn.Linear(pixels, features, bias=False)
        self.norm = nn.BatchNorm1d(frame_stack * features)
        self.enter = nn.Linear(frame_stack * features, hidden_dim)
        self.hidden = nn.Linear(hidden_dim, hidden_dim)
        self.project = nn.Linear(hidden_dim, embedding_dim)

    def embed(self, patches: Tensor) -> Tensor:
        """Normalised patches [N, H / 4, W / 4, 16 * C * frame_stack] to embeddings [N, d] of unit length, float32."""
        frames = patches.flatten(1, 2).unflatten(2, (self.frame_stack, -1)).transpose(1, 2).flatten(2)
        newest = frames[:, -1:]
        described = self.describe(torch.cat((newest, newest - frames[:, :-1]), dim=1))
        entered = F.relu(self.enter(self.norm(described.flatten(1).float())))
        return F.normalize(self.project(entered + F.relu(self.hidden(entered))).float(), dim=-1)
