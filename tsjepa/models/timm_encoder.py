"""A backbone of the package timm as the context encoder."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.encoder import PIXEL_MEAN, PIXEL_STD
from tsjepa.support.foreign import optional


class TimmEncoder(nn.Module):
    """A backbone by name, whose features are flattened (pooling loses positions) and projected to ``d``.

    The frames of a stack are its input channels; timm spreads the weights of a first layer over them.

    Args:
        backbone: name in timm, such as "resnet18".
        embedding_dim: d.
        frame_stack: frames of an embedding, oldest first.
        height, width: of a frame in pixels.
        pretrained: start from the weights that timm downloads; False in an entry, which has its own.
        options: further arguments of ``timm.create_model``, such as {"img_size": [64, 128]} of a transformer.

    Raises:
        ModuleNotFoundError: timm is not installed.
        ValueError: timm has no such backbone, or does not take the options.
    """

    def __init__(
        self,
        backbone: str = "resnet18",
        embedding_dim: int = 64,
        frame_stack: int = 2,
        height: int = 64,
        width: int = 128,
        pretrained: bool = False,
        options: dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self.init_args: dict[str, Any] = {
            "backbone": backbone, "embedding_dim": embedding_dim, "frame_stack": frame_stack, "height": height,
            "width": width, "pretrained": False, "options": dict(options or {}),
        }  # fmt: skip
        self.embedding_dim, self.frame_shape = embedding_dim, (frame_stack, height, width, 3)
        timm = optional("timm", "This encoder", "timm")
        settings = {"num_classes": 0, "global_pool": "", "in_chans": 3 * frame_stack} | self.init_args["options"]
        try:
            self.backbone = timm.create_model(backbone, pretrained=pretrained, **settings)
        except (RuntimeError, TypeError, ValueError) as error:
            raise ValueError(f"timm makes no {backbone} of these settings: {error}") from error
        self.register_buffer("mean", torch.tensor(PIXEL_MEAN).repeat(frame_stack)[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(PIXEL_STD).repeat(frame_stack)[:, None, None], persistent=False)
        with torch.no_grad():
            features = self.backbone.eval()(torch.zeros(1, 3 * frame_stack, height, width)).numel()
        self.backbone.train()
        self.project = nn.Linear(features, embedding_dim)

    def forward(self, frames: Tensor) -> Tensor:
        """uint8 [..., frame_stack, H, W, 3], oldest first, to embeddings [..., d] of unit length."""
        pictures = frames.reshape(-1, *self.frame_shape).movedim(-1, 2).flatten(1, 2)
        features = self.backbone((pictures / 255 - self.mean) / self.std).flatten(1)
        embedding = F.normalize(self.project(features).float(), dim=-1)
        return embedding.reshape(*frames.shape[:-4], self.embedding_dim)
