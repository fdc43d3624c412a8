"""A context encoder for still cameras: what is where in the newest frame, and what has moved since the older ones."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.encoder import PATCH, PatchEncoder, check_convolutions, convolutions
from tsjepa.support.checks import at_least


class DifferenceEncoder(PatchEncoder):
    """Features of the newest frame and their differences to those of the older ones, then a residual MLP.

    A velocity moves an edge by tenths of a pixel between frames, which a network over stacked frames finds only after
    long training. Features of single frames, of which the newest and their changes are passed on, show it at once
    (latent flow; Shang et al., "Reinforcement Learning with Latent Flow", 2021).

    Without ``widths`` the features are a linear map of the pixels, and their change is the map of the pixels' change.
    That is exact, where the difference of two features in bfloat16 is mostly rounding. Every feature weighs all pixels,
    so centres of mass, which are linear in the pixels, cost nothing to find; in exchange nothing is shared between
    places, and a scene that looks otherwise is not forgiven. With ``widths`` convolutions come before the map.

    Args:
        frame_stack: frames per embedding (kappa of the paper), oldest first.
        embedding_dim: d.
        height, width: of a frame in pixels, multiples of 4.
        features: numbers in which the map describes a frame, or a difference.
        hidden_dim: width of the MLP.
        grey: read the luma of every pixel instead of its three colours.
        widths: channels of three residual stages before the map, as :class:`tsjepa.models.Encoder` has them; None for
            none, else the frame's sides are multiples of 32.
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
        widths: tuple[int, int, int] | None = None,
    ) -> None:
        super().__init__(frame_stack, embedding_dim, height, width, grey)
        at_least(1, features=features, hidden_dim=hidden_dim)
        self.features, self.hidden_dim, self.widths = features, hidden_dim, widths and tuple(widths)
        channels, places = (1 if grey else 3) * PATCH**2, height * width // PATCH**2
        if widths is not None:
            check_convolutions(widths, height, width, 1)
            self.stem, self.stages = convolutions(channels, widths, 1)
            channels, places = widths[-1], places // 64
        self.describe = nn.Linear(places * channels, features, bias=False)
        self.norm = nn.BatchNorm1d(frame_stack * features)
        self.enter = nn.Linear(frame_stack * features, hidden_dim)
        self.hidden = nn.Linear(hidden_dim, hidden_dim)
        self.project = nn.Linear(hidden_dim, embedding_dim)

    def embed(self, patches: Tensor) -> Tensor:
        """Normalised patches [N, H / 4, W / 4, 16 * C * frame_stack] to embeddings [N, d] of unit length, float32."""
        # [N, frame_stack, H / 4, W / 4, 16 * C], oldest frame first
        frames = patches.unflatten(3, (self.frame_stack, -1)).movedim(3, 1)
        described = self.changes(frames) if self.widths is None else self.convolved(frames)
        entered = F.relu(self.enter(self.norm(described.flatten(1).float())))
        return F.normalize(self.project(entered + F.relu(self.hidden(entered))).float(), dim=-1)

    def changes(self, frames: Tensor) -> Tensor:
        """The linear map [N, frame_stack, features] of the newest frame, then of its difference to each older one."""
        flat = frames.flatten(2)
        return self.describe(torch.cat((flat[:, -1:], flat[:, -1:] - flat[:, :-1]), dim=1))

    def convolved(self, frames: Tensor) -> Tensor:
        """The same of convolved frames, whose map is not rounded before the differences are taken."""
        pictures = frames.flatten(0, 1).permute(0, 3, 1, 2).contiguous(memory_format=torch.channels_last)
        convolved = self.stages(self.stem(pictures)).permute(0, 2, 3, 1).flatten(1).float()
        with torch.autocast(frames.device.type, enabled=False):
            features = self.describe(convolved).unflatten(0, (-1, self.frame_stack))
        return torch.cat((features[:, -1:], features[:, -1:] - features[:, :-1]), dim=1)
