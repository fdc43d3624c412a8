"""The codec of a fleet's updates, with its ranges, and the bits that a scheduler reserves for one."""

from __future__ import annotations

import torch

from tsjepa.envs.embedding_codec import embedding_codec
from tsjepa.envs.settings import Radio
from tsjepa.models import SemanticController
from tsjepa.radio.codecs import make_codec, payload_bits

FRAME_CODECS = ("raw", "png", "jpeg", "webp")
STATE_RANGE = (1.8, 0.8, 4.0, 4.0)  # m, rad, m/s, rad/s: what an integer codec of the true state covers


def fitted_codec(name: str, model: SemanticController | None) -> torch.nn.Module:
    """The codec of the update: of the true state, of the model's embedding, or of frames.

    Integer codecs get their ranges from the state space or from the model.
    """
    if name in FRAME_CODECS:
        if model is None:
            raise ValueError(f"The codec {name!r} sends frames, which need the encoder of a model as controller.")
        return make_codec(name, frame_stack=model.architecture.frame_stack)
    if model is None:
        codec = make_codec(name, dimension=4)
        return codec.fit(torch.tensor(STATE_RANGE) * torch.tensor([[-1.0], [1.0]])) if name[:3] == "int" else codec
    return embedding_codec(name, model)


def update_bits(radio: Radio, codec: torch.nn.Module, model: SemanticController | None) -> int | None:
    """Bits the scheduler reserves for an update; None where every device takes one block."""
    if radio.resource_blocks is not None:
        return None
    if radio.payload_bits is not None:
        return radio.payload_bits
    if radio.codec in ("png", "jpeg", "webp"):
        raise ValueError(
            f"Packets of the codec {radio.codec!r} vary in length: give radio.payload_bits, the bits to reserve for "
            "one, or radio.resource_blocks."
        )
    if radio.codec == "raw":
        return payload_bits(codec.encode(torch.zeros((1, *codec.shape), dtype=torch.uint8)))[0].item()
    dimension = 4 if model is None else model.architecture.embedding_dim
    return payload_bits(codec.encode(torch.ones(1, dimension)))[0].item()
