"""The generative baseline: its controller reconstructs the frames and applies the expert's law to what they show.

Paper, "Baseline 3: Generative Auto-encoder Model": the device encodes, the remote controller "decodes the received
representations to reconstruct the device state, which is subsequently used to compute the control commands".
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.controller import Controller
from tsjepa.models.decoder import Decoder
from tsjepa.models.encoder import PATCH, ResidualBlock
from tsjepa.support.spec import PlantSpec


class StateEstimator(nn.Module):
    """Small residual network from reconstructed frames to the state [..., n], in the state's own units.

    Args:
        state_dim: n.
        frame_stack: frames it looks at.
        channels: of its three stages.
        height: frame height in pixels.
        width: frame width in pixels.
        hidden_dim: width of its one fully connected layer.
    """

    def __init__(
        self,
        state_dim: int,
        frame_stack: int = 2,
        channels: tuple[int, int, int] = (32, 64, 64),
        height: int = 64,
        width: int = 128,
        hidden_dim: int = 128,
    ) -> None:
        super().__init__()
        self.state_dim, self.frame_stack, self.channels = state_dim, frame_stack, tuple(channels)
        self.height, self.width, self.hidden_dim = height, width, hidden_dim
        first, second, third = channels
        self.stages = nn.Sequential(
            nn.Conv2d(3 * PATCH**2 * frame_stack, first, 3, padding=1, bias=False),
            nn.BatchNorm2d(first),
            nn.ReLU(),
            ResidualBlock(first, second, 2),
            ResidualBlock(second, third, 2),
        )
        self.hidden = nn.Linear(third * -(-height // (4 * PATCH)) * -(-width // (4 * PATCH)), hidden_dim)
        self.output = nn.Linear(hidden_dim, state_dim)
        self.register_buffer("state_mean", torch.zeros(state_dim))
        self.register_buffer("state_std", torch.ones(state_dim))
        self.to(memory_format=torch.channels_last)

    def forward(self, drawn: Tensor) -> Tensor:
        """State [N, n] from what :meth:`Decoder.draw` gives [N, H / 4, W / 4, frame_stack * 48]."""
        features = self.stages(drawn.permute(0, 3, 1, 2)).permute(0, 2, 3, 1).flatten(1)
        return self.output(F.relu(self.hidden(features))).float() * self.state_std + self.state_mean


class AutoencoderController(Controller):
    """Encoder (on the device), decoder, state estimator and the expert's law (at the controller).

    It has no predictor: between updates its last command is held.

    Args:
        encoder: see :class:`Controller`.
        decoder: of as many frames as the encoder takes.
        estimator: from what the decoder draws to the state.
        law: from a state [..., n] and set-points [..., r] to a command [..., m]; saved with the weights.
        frame_spacing: slots between the frames of a stack.
        spec: names, units and ranges of the plant.
    """

    kind = "autoencoder"

    def __init__(
        self,
        encoder: nn.Module,
        decoder: Decoder,
        estimator: StateEstimator,
        law: nn.Module,
        frame_spacing: int,
        spec: PlantSpec,
    ) -> None:
        super().__init__(encoder, frame_spacing, spec)
        self.decoder, self.estimator, self.law = decoder, estimator, law

    def decode(self, embedding: Tensor) -> Tensor:
        """Newest frame of an embedding [..., d] as it is reconstructed: float [..., H, W, 3] in 0..255."""
        return self.decoder(embedding)[..., -1, :, :, :]

    def probe(self, embedding: Tensor) -> Tensor:
        """State [..., n] read from the frames reconstructed from ``embedding`` [..., d]."""
        flat = embedding.reshape(-1, embedding.shape[-1])
        state = self.estimator(self.decoder.draw(flat))
        return state.reshape(*embedding.shape[:-1], state.shape[-1])

    def act(self, embedding: Tensor, reference: Tensor | None = None) -> Tensor:
        """Command [..., m] for ``embedding`` [..., d]: the law applied to the estimated state."""
        return self.law(self.probe(embedding), reference)

    def predict(self, embedding: Tensor, command: Tensor) -> Tensor:
        """Always refuses.

        Raises:
            ValueError: an autoencoder has no predictor.
        """
        raise ValueError("An autoencoder has no predictor (has_predictor is False); hold the last command.")
