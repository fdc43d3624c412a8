"""What an update is sent as: the codec between a device and its controller, its ranges, and the bits to reserve."""

from __future__ import annotations

import torch
from torch import nn

from tsjepa.envs.settings import Radio
from tsjepa.models import Controller
from tsjepa.radio.codecs import FRAME_CODECS, STREAM, make_codec, payload_bits
from tsjepa.radio.video import frame_stream
from tsjepa.support.spec import PlantSpec


class UnitNorm(nn.Module):
    """A codec whose receiver brings what it decodes back to unit length, as the predictor and the actor expect."""

    def __init__(self, codec: nn.Module) -> None:
        super().__init__()
        self.codec = codec

    def encode(self, values: torch.Tensor):
        return self.codec.encode(values)

    def decode(self, packets) -> torch.Tensor:
        return nn.functional.normalize(self.codec.decode(packets), dim=-1)


def sends_frames(codec: str) -> bool:
    """Whether a codec sends frames, which the controller encodes, instead of what the device made of them."""
    return codec in FRAME_CODECS or codec.startswith(STREAM)


def embedding_codec(name: str, model: Controller) -> nn.Module:
    """The codec that sends the embeddings [N, d] of ``model``: "fp32", "fp16", "int8" or "int4".

    Raises:
        ValueError: an integer codec for a model that came without ranges.
    """
    codec = make_codec(name, dimension=model.embedding_dim)
    if name in ("int8", "int4"):
        if bool(model.code_low.isnan().any()):
            raise ValueError(
                f"The codec {name} needs ranges, which this model lacks: fit its actor again with the callback "
                "tsjepa.training.finish.codec.FitCodec, or send fp16."
            )
        codec.low.copy_(model.code_low)
        codec.high.copy_(model.code_high)
    return UnitNorm(codec)


def state_codec(name: str, spec: PlantSpec) -> nn.Module:
    """The codec that sends a plant's state [N, n]; integer codecs cover ``spec.state_scale``."""
    codec = make_codec(name, dimension=spec.state_dim)
    if name in ("int8", "int4"):
        codec.fit(torch.tensor(spec.state_scale) * torch.tensor([[-1.0], [1.0]]))
    return codec


def frame_codec(name: str, model: Controller, quality: int = 50) -> nn.Module:
    """The codec that sends the frames that ``model`` stacks, in one picture or, as a stream, one by one.

    Args:
        name: one of :data:`FRAME_CODECS`, which with "stream-" before it sends the newest frame alone, or
            "stream-h264". A stream wants an update of every device in every slot.
        model: whose frames are sent.
        quality: see :func:`tsjepa.radio.video.frame_stream`.

    Raises:
        ValueError: a stream for a model that does not stack neighbouring frames.
    """
    stack, height, width, _ = model.encoder.frame_shape
    if name.startswith(STREAM):
        if model.frame_spacing != 1:
            raise ValueError(
                "A stream of frames needs a model whose stack holds neighbouring frames (frame_spacing 1)."
            )
        return frame_stream(name.removeprefix(STREAM), quality, height, width)
    return make_codec(name, quality=quality, frame_stack=stack, height=height, width=width)


def update_codec(radio: Radio, spec: PlantSpec, model: Controller | None) -> nn.Module:
    """The codec of an update: of frames or of the model's embedding, or without a model of the true state.

    Raises:
        ValueError: frames without a model to read them.
    """
    if sends_frames(radio.codec):
        if model is None:
            raise ValueError(
                f"The codec {radio.codec!r} sends frames, which need the encoder of a model as controller."
            )
        return frame_codec(radio.codec, model, radio.quality)
    return state_codec(radio.codec, spec) if model is None else embedding_codec(radio.codec, model)


def update_bits(
    radio: Radio, spec: PlantSpec, model: Controller | None, codec: nn.Module
) -> int | tuple[int, ...] | None:
    """Bits the scheduler reserves for an update; None where every device takes one block.

    Raises:
        ValueError: the codec's packets vary in length and nobody says how many bits to reserve.
    """
    if radio.resource_blocks is not None:
        return None
    return packet_bits(radio, spec, model, codec)


def packet_bits(radio: Radio, spec: PlantSpec, model: Controller | None, codec: nn.Module) -> int | tuple[int, ...]:
    """Bits of an update, as given or as the codec makes them.

    Raises:
        ValueError: the codec's packets vary in length and nobody says how many bits to reserve.
    """
    if radio.payload_bits is not None:
        return radio.payload_bits
    if sends_frames(radio.codec) and radio.codec != "raw":
        raise ValueError(
            f"Packets of the codec {radio.codec!r} vary in length: give radio.payload_bits, the bits to reserve for "
            "one, or radio.resource_blocks and no MCS."
        )
    return codec_bits(radio, spec, model, codec)


def codec_bits(radio: Radio, spec: PlantSpec, model: Controller | None, codec: nn.Module) -> int:
    """Bits in an update of a codec whose packets all have the same length."""
    if radio.codec == "raw":
        sample = torch.zeros((1, *codec.shape), dtype=torch.uint8)
    else:
        sample = torch.ones(1, spec.state_dim if model is None else model.embedding_dim)
    return int(payload_bits(codec.encode(sample))[0])
