"""The decoder: an embedding back to frames. The autoencoder trains through it; elsewhere it only shows what z holds."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.encoder import PATCH, unpatchify


class Upsample(nn.Sequential):
    """Twice the picture: nearest neighbours, a 3x3 convolution, batch normalisation."""

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__(
            nn.Upsample(scale_factor=2),
            nn.Conv2d(in_channels, out_channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(out_channels),
            nn.ReLU(),
        )


class Decoder(nn.Module):
    """Two linear layers to a coarse picture that is doubled three times, then a convolution to patches of 4x4 pixels.

    It draws the difference to a ``background``, in units of each pixel's ``contrast``; both are saved with the weights.
    So neither it nor the embedding carries what never changes, and a thin pole weighs as much as the cart.

    Args:
        embedding_dim: d.
        frame_stack: frames that are drawn, oldest first.
        channels: of the coarse picture and after each doubling.
        height: frame height in pixels, a multiple of 4.
        width: frame width in pixels, a multiple of 4.
    """

    def __init__(
        self,
        embedding_dim: int = 256,
        frame_stack: int = 1,
        channels: tuple[int, int, int, int] = (128, 64, 32, 32),
        height: int = 64,
        width: int = 128,
    ) -> None:
        super().__init__()
        self.embedding_dim, self.frame_stack, self.channels = embedding_dim, frame_stack, tuple(channels)
        self.height, self.width = height, width
        self.scale = embedding_dim**0.5
        # rounded up: what is drawn beyond the frame is cut off
        self.coarse_shape = (channels[0], -(-height // (8 * PATCH)), -(-width // (8 * PATCH)))
        self.hidden = nn.Linear(embedding_dim, embedding_dim)
        self.project = nn.Linear(embedding_dim, self.coarse_shape[0] * self.coarse_shape[1] * self.coarse_shape[2])
        self.stages = nn.Sequential(*(Upsample(*pair) for pair in pairwise(channels)))
        self.patches = nn.Conv2d(channels[-1], frame_stack * 3 * PATCH**2, 3, padding=1)
        shape = (height // PATCH, width // PATCH, frame_stack * 3 * PATCH**2)
        self.register_buffer("background", torch.zeros(shape))
        self.register_buffer("contrast", torch.ones(shape))
        self.register_buffer("fitted", torch.tensor(False))
        self.to(memory_format=torch.channels_last)

    def draw(self, embedding: Tensor) -> Tensor:
        """From embeddings [N, d] to (patches - background) / contrast [N, H / 4, W / 4, frame_stack * 48]."""
        hidden = F.relu(self.hidden(embedding * self.scale))
        coarse = F.relu(self.project(hidden)).unflatten(1, self.coarse_shape)
        height, width, _ = self.background.shape
        return self.patches(self.stages(coarse)).permute(0, 2, 3, 1)[:, :height, :width]

    def forward(self, embedding: Tensor) -> Tensor:
        """Frames [..., frame_stack, H, W, 3] in 0..255 from ``embedding`` [..., d] of unit length.

        Raises:
            ValueError: this decoder was never trained.
        """
        if not self.fitted:
            raise ValueError(
                "The decoder of this model was never trained, so that its embeddings cannot be drawn; add "
                "tsjepa.training.finish.decoder.FitDecoder to the recipe, before ExportModel."
            )
        drawn = self.draw(embedding.reshape(-1, embedding.shape[-1])).float()
        frames = unpatchify((self.background + self.contrast * drawn).clamp(0, 255))
        return frames.reshape(*embedding.shape[:-1], *frames.shape[1:])
