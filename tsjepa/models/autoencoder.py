"""The generative baseline: its controller reconstructs the frames and applies the expert's law to what they show.

Paper, "Baseline 3: Generative Auto-encoder Model": the device encodes, the remote controller "decodes the received
representations to reconstruct the device state, which is subsequently used to compute the control commands".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.actor import COMMAND_LIMIT
from tsjepa.models.decoder import Decoder
from tsjepa.models.encoder import PATCH, Encoder, ResidualBlock
from tsjepa.models.hub import HubModel


@dataclass
class AutoencoderArchitecture:
    """Sizes that rebuild an :class:`AutoencoderController`; the fields are the arguments of its parts."""

    frame_stack: int = 2
    frame_spacing: int = 1
    widths: tuple[int, int, int] = (32, 64, 128)
    embedding_dim: int = 256
    decoder_channels: tuple[int, int, int, int] = (128, 64, 32, 32)
    estimator_channels: tuple[int, int, int] = (32, 64, 64)
    sampling_interval: float = 0.02

    has_predictor: ClassVar[bool] = False


class StateEstimator(nn.Module):
    """Small residual network from reconstructed frames to the state [..., 4] (m, rad, m/s, rad/s).

    Args:
        frame_stack: frames it looks at.
        channels: of its three stages.
        height: frame height in pixels.
        width: frame width in pixels.
        hidden_dim: width of its one fully connected layer.
    """

    def __init__(
        self,
        frame_stack: int = 2,
        channels: tuple[int, int, int] = (32, 64, 64),
        height: int = 64,
        width: int = 128,
        hidden_dim: int = 128,
    ) -> None:
        super().__init__()
        first, second, third = channels
        self.stages = nn.Sequential(
            nn.Conv2d(3 * PATCH**2 * frame_stack, first, 3, padding=1, bias=False),
            nn.BatchNorm2d(first),
            nn.ReLU(),
            ResidualBlock(first, second, 2),
            ResidualBlock(second, third, 2),
        )
        self.hidden = nn.Linear(third * (height // (4 * PATCH)) * (width // (4 * PATCH)), hidden_dim)
        self.output = nn.Linear(hidden_dim, 4)
        self.register_buffer("state_mean", torch.zeros(4))
        self.register_buffer("state_std", torch.ones(4))
        self.to(memory_format=torch.channels_last)

    def forward(self, drawn: Tensor) -> Tensor:
        """State [N, 4] from what :meth:`Decoder.draw` gives [N, H / 4, W / 4, frame_stack * 48]."""
        features = self.stages(drawn.permute(0, 3, 1, 2)).permute(0, 2, 3, 1).flatten(1)
        return self.output(F.relu(self.hidden(features))).float() * self.state_std + self.state_mean


class ClippedLinearLaw(nn.Module):
    """The expert's law, with its numbers saved beside the weights: u = -K (clip(x), theta, x_dot, theta_dot).

    ``gain`` is K [4] and ``position_clip`` the largest position error it reacts to, in metres; both NaN until set.
    """

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("gain", torch.full((4,), math.nan))
        self.register_buffer("position_clip", torch.tensor(math.nan))

    def forward(self, state: Tensor) -> Tensor:
        """Command [..., 1] in newtons, within +-20, for ``state`` [..., 4]."""
        position = state[..., :1].clamp(-self.position_clip, self.position_clip)
        features = torch.cat((position, state[..., 1:]), dim=-1)
        return -(features * self.gain).sum(-1, keepdim=True).clamp(-COMMAND_LIMIT, COMMAND_LIMIT)


class AutoencoderController(HubModel, nn.Module):
    """Encoder (on the device), decoder, state estimator and the expert's law (at the controller).

    It has no predictor: between updates its last command is held.

    Args:
        architecture: sizes of the parts; see :class:`tsjepa.models.SemanticController`.

    ``code_low`` and ``code_high`` [d] are the ranges over which an integer codec sends an embedding; NaN until
    :class:`tsjepa.training.finish.codec.FitCodec` has set them.
    """

    def __init__(self, architecture: AutoencoderArchitecture) -> None:
        super().__init__()
        dim, stack = architecture.embedding_dim, architecture.frame_stack
        self.architecture = architecture
        self.encoder = Encoder(stack, architecture.widths, dim)
        self.decoder = Decoder(dim, stack, architecture.decoder_channels)
        self.estimator = StateEstimator(stack, architecture.estimator_channels)
        self.law = ClippedLinearLaw()
        self.register_buffer("code_low", torch.full((dim,), math.nan))
        self.register_buffer("code_high", torch.full((dim,), math.nan))

    @property
    def frame_history(self) -> int:
        """Slots that one stack spans."""
        return (self.architecture.frame_stack - 1) * self.architecture.frame_spacing + 1

    def encode(self, frames: Tensor) -> Tensor:
        """uint8 [..., frame_stack, H, W, 3], oldest first, to embeddings [..., d] of unit length."""
        return self.encoder(frames)

    def decode(self, embedding: Tensor) -> Tensor:
        """Newest frame of an embedding [..., d] as it is reconstructed: float [..., H, W, 3] in 0..255."""
        return self.decoder(embedding)[..., -1, :, :, :]

    def probe(self, embedding: Tensor) -> Tensor:
        """State [..., 4] (m, rad, m/s, rad/s) read from the frames reconstructed from ``embedding`` [..., d]."""
        flat = embedding.reshape(-1, embedding.shape[-1])
        return self.estimator(self.decoder.draw(flat)).reshape(*embedding.shape[:-1], 4)

    def act(self, embedding: Tensor) -> Tensor:
        """Command [..., 1] in newtons for ``embedding`` [..., d]: the law applied to the estimated state."""
        return self.law(self.probe(embedding))

    def predict(self, embedding: Tensor, command: Tensor) -> Tensor:
        """Always refuses.

        Raises:
            ValueError: an autoencoder has no predictor.
        """
        raise ValueError("An autoencoder has no predictor (has_predictor is False); hold the last command.")
