"""What one device puts on the air, and the embedding that the controller has of it.

A sender has ``send(frames, fresh)``: stacks of frames uint8 [N, kappa, H, W, 3] to embeddings [N, d] and the bits int64
[N] of the packets; ``fresh`` says that it is the first slot of the loops.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from tsjepa.envs.payload import embedding_codec
from tsjepa.radio.codecs import make_codec, payload_bits

SENDS = ("embedding", "stack", "stream", "video")
SEI = 6  # the unit of an H.264 stream in which x264 writes its own name and settings


def make_sender(model: nn.Module, sends: str, codec: str, quality: int | None):
    """The sender of a point.

    Args:
        model: the controller.
        sends: "embedding"; "stack", every frame that the controller stacks, in one picture; "stream", the newest frame
            alone, the older ones being kept from the slots before; or "video", the same as H.264.
        codec: of ``make_codec``.
        quality: of JPEG and WebP; of H.264 the constant rate factor, 0 to 51, lower is better.
    """
    if sends == "embedding":
        return EmbeddingSender(model, embedding_codec(codec, model))
    stack = model.frame_stack
    if sends == "stack":
        return StackSender(model, make_codec(codec, quality=quality or 50, frame_stack=stack))
    if sends not in SENDS:
        raise ValueError(f"A device cannot send {sends!r}; choose from {', '.join(SENDS)}.")
    if model.frame_spacing != 1:
        raise ValueError("A stream of frames needs a model whose stack holds neighbouring frames (frame_spacing 1).")
    if sends == "video":
        return StreamSender(model, H264(quality))
    return StreamSender(model, Stills(make_codec(codec, quality=quality or 50, frame_stack=1)))


class EmbeddingSender:
    """The device encodes; the embedding travels through a codec."""

    def __init__(self, model: nn.Module, codec: nn.Module) -> None:
        self.model, self.codec = model, codec

    def send(self, frames: Tensor, fresh: bool) -> tuple[Tensor, Tensor]:
        packets = self.codec.encode(self.model.encode(frames))
        return self.codec.decode(packets), payload_bits(packets)


class StackSender:
    """The whole stack travels in one picture; the controller encodes it. Every update stands by itself."""

    def __init__(self, model: nn.Module, codec: nn.Module) -> None:
        self.model, self.codec = model, codec

    def send(self, frames: Tensor, fresh: bool) -> tuple[Tensor, Tensor]:
        packets = self.codec.encode(frames)
        return self.model.encode(self.codec.decode(packets)), payload_bits(packets)


class StreamSender:
    """The newest frame travels in every slot, the whole stack in the first; the controller keeps the older ones."""

    def __init__(self, model: nn.Module, channel) -> None:
        self.model, self.channel = model, channel

    def send(self, frames: Tensor, fresh: bool) -> tuple[Tensor, Tensor]:
        if fresh:
            self.channel.start(len(frames))
            sent = [self.channel.send(frames[:, index]) for index in range(frames.shape[1])]
            self.kept = torch.stack([frame for frame, _ in sent], 1)
            return self.model.encode(self.kept), sum(bits for _, bits in sent)
        newest, bits = self.channel.send(frames[:, -1])
        self.kept = torch.cat((self.kept[:, 1:], newest[:, None]), 1)
        return self.model.encode(self.kept), bits


class Stills:
    """Frames uint8 [N, H, W, 3] one by one through a codec for still pictures."""

    def __init__(self, codec: nn.Module) -> None:
        self.codec = codec

    def start(self, count: int) -> None:
        """N new streams; stills remember nothing."""

    def send(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        packets = self.codec.encode(frames[:, None])
        return self.codec.decode(packets)[:, 0], payload_bits(packets)


class H264:
    """Frames as H.264 without delay (x264, one key frame, then differences), one stream a device.

    Args:
        rate_factor: constant rate factor of x264, 0 to 51.
    """

    def __init__(self, rate_factor: int) -> None:
        self.rate_factor = rate_factor

    def start(self, count: int) -> None:
        """N new streams."""
        self.streams = [(self._encoder(), self._decoder()) for _ in range(count)]

    def _encoder(self):
        import av

        encoder = av.CodecContext.create("libx264", "w")
        encoder.width, encoder.height, encoder.pix_fmt, encoder.framerate = 128, 64, "yuv420p", 50
        encoder.gop_size, encoder.thread_count = 100_000, 1
        encoder.options = {"preset": "medium", "tune": "zerolatency", "crf": str(self.rate_factor)}
        return encoder

    def _decoder(self):
        import av

        decoder = av.CodecContext.create("h264", "r")
        decoder.thread_count = 1
        return decoder

    def send(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        import av

        shown, bits = [], []
        for (encoder, decoder), frame in zip(self.streams, frames.numpy(), strict=True):
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24").reformat(format="yuv420p")
            data = b"".join(without_sei(bytes(packet)) for packet in encoder.encode(picture))
            (decoded,) = decoder.decode(av.Packet(data))
            shown.append(torch.from_numpy(decoded.to_ndarray(format="rgb24")))
            bits.append(8 * len(data))
        return torch.stack(shown), torch.tensor(bits)


def without_sei(data: bytes) -> bytes:
    """An H.264 byte stream without its supplemental information, which a device would not send."""
    units = data.replace(b"\x00\x00\x00\x01", b"\x00\x00\x01").split(b"\x00\x00\x01")[1:]
    return b"".join(b"\x00\x00\x01" + unit for unit in units if unit[0] & 31 != SEI)
