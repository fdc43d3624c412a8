"""Codecs: what a device really sends, in bytes, and what the receiver makes of it.

Every codec has two methods, for a batch of N values:

    encode(values [N, ...]) -> packets, N of them, each a row of bytes
    decode(packets) -> values [N, ...] as the receiver gets them

Vector codecs send a fixed number of bytes, so their packets are one uint8 tensor [N, bytes]; frame codecs send a
``bytes`` object per device. :func:`payload_bits` counts either.
"""

import math
from collections.abc import Sequence
from typing import TypeAlias

import cv2
import numpy as np
import torch
from torch import Tensor, nn

Packets: TypeAlias = "Tensor | Sequence[bytes]"
FRAME_CODECS = ("raw", "png", "jpeg", "webp")
STREAM = "stream-"  # before the name of a codec: the newest frame of a stack travels alone, see tsjepa.radio.video


def payload_bits(packets: Packets) -> Tensor:
    """Bits in each packet, int64 [N]."""
    if isinstance(packets, Tensor):
        return torch.full((packets.shape[0],), 8 * packets.shape[1], dtype=torch.int64, device=packets.device)
    return torch.tensor([8 * len(packet) for packet in packets], dtype=torch.int64)


class FloatCodec(nn.Module):
    """Vectors [N, d] as IEEE floats, 32 or 16 bits each; the true state of a plant is sent this way too.

    Raises:
        ValueError: on encoding values that the format turns into infinity or that are not numbers.
    """

    def __init__(self, bits: int = 32):
        super().__init__()
        formats = {32: torch.float32, 16: torch.float16}
        if bits not in formats:
            raise ValueError(f"FloatCodec knows 16 and 32 bits, not {bits}")
        self.dtype = formats[bits]

    def encode(self, values: Tensor) -> Tensor:
        _check_vectors(values)
        numbers = values.to(self.dtype).contiguous()
        if not bool(torch.isfinite(numbers).all()):
            raise ValueError(f"cannot send values that are not finite as {self.dtype}: largest is {values.abs().max()}")
        return numbers.view(torch.uint8)

    def decode(self, packets: Tensor) -> Tensor:
        return packets.contiguous().view(self.dtype).to(torch.float32)


class AffineCodec(nn.Module):
    """Vectors [N, d] as unsigned integers of 8 or 4 bits, each dimension over its own range.

    The ranges are learned from training data by :meth:`fit` and saved with the module; values outside them saturate.
    Two 4-bit numbers share a byte, the first in the high half; an odd d is padded by half a byte.

    Args:
        dimension: d.
        bits: 8 or 4.
    """

    def __init__(self, dimension: int, bits: int = 8):
        super().__init__()
        if bits not in (4, 8):
            raise ValueError(f"AffineCodec knows 4 and 8 bits, not {bits}")
        self.bits = bits
        self.register_buffer("low", torch.full((dimension,), math.nan))
        self.register_buffer("high", torch.full((dimension,), math.nan))

    def fit(self, values: Tensor) -> "AffineCodec":
        """Learn the ranges: the smallest and largest value of each dimension of [..., d]. Returns itself."""
        flat = values.reshape(-1, values.shape[-1]).to(self.low)
        if flat.shape[-1] != self.low.numel() or not bool(torch.isfinite(flat).all()):
            raise ValueError(f"fit needs finite values of {self.low.numel()} dimensions, got {tuple(values.shape)}")
        self.low.copy_(flat.amin(0))
        self.high.copy_(flat.amax(0))
        return self

    def encode(self, values: Tensor) -> Tensor:
        _check_vectors(values)
        step = self._step()
        # a graph that is being exported has no values to check
        if not torch.compiler.is_exporting() and not bool(torch.isfinite(values).all()):
            raise ValueError("cannot send values that are not finite")
        levels = ((values - self.low) / step).round().clamp(0, 2**self.bits - 1).to(torch.uint8)
        if self.bits == 8:
            return levels
        if levels.shape[-1] % 2:
            levels = nn.functional.pad(levels, (0, 1))
        return (levels[..., 0::2] << 4) | levels[..., 1::2]

    def decode(self, packets: Tensor) -> Tensor:
        levels = packets
        if self.bits == 4:
            levels = torch.stack((packets >> 4, packets & 15), -1).flatten(-2)[..., : self.low.numel()]
        return self.low + levels * self._step()

    def _step(self) -> Tensor:
        if not torch.compiler.is_exporting() and bool(torch.isnan(self.low).any()):
            raise ValueError("this AffineCodec has no ranges yet: call fit(training values) or load a saved one")
        step = (self.high - self.low) / (2**self.bits - 1)
        # a dimension that never varied is sent as level 0
        return torch.where(step > 0, step, 1.0)


class RawFrameCodec(nn.Module):
    """Frames uint8 [N, frame_stack, H, W, 3], uncompressed."""

    def __init__(self, frame_stack: int = 2, height: int = 64, width: int = 128):
        super().__init__()
        self.shape = (frame_stack, height, width, 3)

    def encode(self, values: Tensor) -> Tensor:
        _check_frames(values, self.shape)
        return values.flatten(1)

    def decode(self, packets: Tensor) -> Tensor:
        return packets.reshape(len(packets), *self.shape)


class ImageCodec(nn.Module):
    """Frames uint8 [N, frame_stack, H, W, 3] as one PNG, JPEG or WebP image per device (OpenCV).

    The frames of a stack are put below each other, so that they share the header.

    Args:
        kind: "png", "jpeg" or "webp".
        quality: 1 to 100 for JPEG and WebP; PNG is lossless and takes none.
        frame_stack, height, width: shape of the frames.
    """

    def __init__(self, kind: str, quality: int = 50, frame_stack: int = 2, height: int = 64, width: int = 128):
        super().__init__()
        settings = {
            "png": (".png", [cv2.IMWRITE_PNG_COMPRESSION, 9]),
            "jpeg": (".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality]),
            "webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, quality]),
        }
        if kind not in settings:
            raise ValueError(f"unknown image format {kind!r}: choose one of {', '.join(settings)}")
        if not 1 <= quality <= 100:
            raise ValueError(f"image quality {quality} must lie between 1 and 100")
        self.extension, self.parameters_ = settings[kind]
        self.shape = (frame_stack, height, width, 3)

    def encode(self, values: Tensor) -> list[bytes]:
        _check_frames(values, self.shape)
        packets = []
        for stack in values.cpu().numpy():
            picture = np.ascontiguousarray(stack.reshape(-1, *stack.shape[2:])[..., ::-1])
            done, data = cv2.imencode(self.extension, picture, self.parameters_)
            if not done:
                raise RuntimeError(f"OpenCV could not encode a {self.extension} image")
            packets.append(data.tobytes())
        return packets

    def decode(self, packets: Sequence[bytes]) -> Tensor:
        values = torch.empty((len(packets), *self.shape), dtype=torch.uint8)
        for value, packet in zip(values, packets, strict=True):
            picture = cv2.imdecode(np.frombuffer(packet, dtype=np.uint8), cv2.IMREAD_COLOR)
            if picture is None:
                raise ValueError("a packet holds no picture that OpenCV can decode")
            value.copy_(torch.from_numpy(picture[..., ::-1].copy()).view(self.shape))
        return values


def make_codec(
    name: str,
    dimension: int = 256,
    quality: int = 50,
    frame_stack: int = 2,
    height: int = 64,
    width: int = 128,
) -> nn.Module:
    """A codec by name: "fp32", "fp16", "int8", "int4", "state" (fp32), "raw", "png", "jpeg" or "webp".

    ``dimension`` is used by the integer codecs, which still have to be fitted; the rest by the frame codecs.
    """
    if name in ("fp32", "state"):
        return FloatCodec(32)
    if name == "fp16":
        return FloatCodec(16)
    if name in ("int8", "int4"):
        return AffineCodec(dimension, int(name[3:]))
    if name == "raw":
        return RawFrameCodec(frame_stack, height, width)
    if name in ("png", "jpeg", "webp"):
        return ImageCodec(name, quality, frame_stack, height, width)
    raise ValueError(f"unknown codec {name!r}: choose fp32, fp16, int8, int4, state, raw, png, jpeg or webp")


def _check_vectors(values: Tensor) -> None:
    if values.ndim != 2 or not values.is_floating_point():
        raise ValueError(f"expected vectors [N, d] of floats, got {values.dtype} {tuple(values.shape)}")


def _check_frames(values: Tensor, shape: tuple[int, ...]) -> None:
    if values.dtype != torch.uint8 or tuple(values.shape[1:]) != shape:
        raise ValueError(
            f"expected uint8 frames [N, {', '.join(map(str, shape))}], got {values.dtype} {tuple(values.shape)}"
        )
