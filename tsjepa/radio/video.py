"""Codecs that send the newest frame of a stack alone; both ends keep the older ones from the slots before.

They remember what was sent, so one instance serves one run in which every device sends in every slot.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from tsjepa.radio.codecs import make_codec

SEI = 6  # the unit of an H.264 stream in which x264 writes its own name and settings


class FrameStream(nn.Module):
    """Stacks uint8 [N, frame_stack, H, W, 3], of which the newest frame travels, and in the first slot the whole stack.

    Args:
        link: what carries single frames: :class:`Stills` or :class:`H264`.
    """

    def __init__(self, link: Stills | H264) -> None:
        super().__init__()
        self.link = link
        self.kept: Tensor | None = None

    def restart(self) -> None:
        """Forgets what was sent, as at the start of an episode."""
        self.kept = None

    def encode(self, values: Tensor) -> list[bytes]:
        """One packet a device; the frames behind the newest travel in the first slot alone."""
        if self.kept is None:
            self.link.start(len(values))
            self.kept = values[:, :0]
        new = values if not self.kept.shape[1] else values[:, -1:]
        sent = [self.link.send(new[:, frame]) for frame in range(new.shape[1])]
        shown = torch.stack([frames for frames, _ in sent], 1)
        self.kept = torch.cat((self.kept, shown), 1)[:, -values.shape[1] :]
        return [b"".join(packets) for packets in zip(*(packets for _, packets in sent), strict=True)]

    def decode(self, packets: Sequence[bytes]) -> Tensor:
        """The stacks as the receiver has them after the packets of this slot."""
        return self.kept


class Stills:
    """Frames uint8 [N, H, W, 3] one by one through a codec for still pictures.

    Args:
        codec: see :func:`tsjepa.radio.codecs.make_codec`, of one frame.
    """

    def __init__(self, codec: nn.Module) -> None:
        self.codec = codec

    def start(self, count: int) -> None:
        """N new streams; stills remember nothing."""

    def send(self, frames: Tensor) -> tuple[Tensor, list[bytes]]:
        """Frames [N, H, W, 3] as they arrive, and the packets."""
        packets = self.codec.encode(frames[:, None])
        decoded = self.codec.decode(packets)[:, 0]
        return decoded, [bytes(packet.numpy()) if isinstance(packet, Tensor) else packet for packet in packets]


class H264:
    """Frames as H.264 without delay (x264, one key frame, then differences), one stream a device.

    Args:
        rate_factor: constant rate factor of x264, 0 to 51, lower is better.
        height, width: of a frame in pixels.
    """

    def __init__(self, rate_factor: int, height: int, width: int) -> None:
        self.rate_factor, self.height, self.width = rate_factor, height, width

    def start(self, count: int) -> None:
        """N new streams."""
        self.streams = [(self._encoder(), self._decoder()) for _ in range(count)]

    def _encoder(self):
        import av

        encoder = av.CodecContext.create("libx264", "w")
        encoder.width, encoder.height, encoder.pix_fmt, encoder.framerate = self.width, self.height, "yuv420p", 50
        encoder.gop_size, encoder.thread_count = 100_000, 1
        encoder.options = {"preset": "medium", "tune": "zerolatency", "crf": str(self.rate_factor)}
        return encoder

    def _decoder(self):
        import av

        decoder = av.CodecContext.create("h264", "r")
        decoder.thread_count = 1
        return decoder

    def send(self, frames: Tensor) -> tuple[Tensor, list[bytes]]:
        """Frames [N, H, W, 3] as they arrive, and the packets."""
        import av

        shown, packets = [], []
        for (encoder, decoder), frame in zip(self.streams, frames.numpy(), strict=True):
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24").reformat(format="yuv420p")
            data = b"".join(without_sei(bytes(packet)) for packet in encoder.encode(picture))
            (decoded,) = decoder.decode(av.Packet(data))
            shown.append(torch.from_numpy(decoded.to_ndarray(format="rgb24")))
            packets.append(data)
        return torch.stack(shown), packets


def frame_stream(name: str, quality: int, height: int, width: int) -> FrameStream:
    """A stream by the name of its codec: "h264", or one of still pictures ("raw", "png", "jpeg", "webp").

    Args:
        name: of the codec.
        quality: of JPEG and WebP, 1 to 100; of H.264 the constant rate factor, 0 to 51.
        height, width: of a frame in pixels.
    """
    if name == "h264":
        return FrameStream(H264(quality, height, width))
    return FrameStream(Stills(make_codec(name, quality=quality, frame_stack=1, height=height, width=width)))


def without_sei(data: bytes) -> bytes:
    """An H.264 byte stream without its supplemental information, which a device would not send."""
    units = data.replace(b"\x00\x00\x00\x01", b"\x00\x00\x01").split(b"\x00\x00\x01")[1:]
    return b"".join(b"\x00\x00\x01" + unit for unit in units if unit[0] & 31 != SEI)
