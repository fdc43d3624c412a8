"""Streams of frames: bits of the real packets, and what the controller makes of them."""

import pytest
import torch

from tsjepa.radio.codecs import make_codec, payload_bits
from tsjepa.radio.video import H264, frame_stream, without_sei

HEIGHT, WIDTH = 64, 128
FRAME_BITS = HEIGHT * WIDTH * 3 * 8


def moving_square(slots: int) -> torch.Tensor:
    """uint8 [slots, 2, H, W, 3]: neighbouring frames of a square that moves and brightens."""
    frames = torch.zeros(slots + 1, HEIGHT, WIDTH, 3, dtype=torch.uint8)
    for slot in range(slots + 1):
        frames[slot, 20:40, 10 + slot : 40 + slot] = 100 + 5 * slot
    return torch.stack((frames[:-1], frames[1:]), 1)


@pytest.mark.parametrize("codec", ["raw", "png"])
def test_a_lossless_stream_of_single_frames_gives_the_stacks(codec):
    stream, alone = frame_stream(codec, 50, HEIGHT, WIDTH), make_codec(codec, frame_stack=1)
    for slot, stack in enumerate(moving_square(4)):
        packets = stream.encode(stack[None])
        assert torch.equal(stream.decode(packets), stack[None])
        sent = stack if slot == 0 else stack[1:]
        assert payload_bits(packets).tolist() == [int(payload_bits(alone.encode(sent[:, None])).sum())]


def test_a_stream_shows_each_device_its_own_frames():
    stream, frames = frame_stream("raw", 50, HEIGHT, WIDTH), moving_square(3)
    for stack in frames:
        both = torch.stack((stack, 255 - stack))
        assert torch.equal(stream.decode(stream.encode(both)), both)


def test_a_lower_quality_needs_fewer_bits_and_shows_the_frames_less_well():
    sent = []
    for quality in (90, 10):
        stream, frames = frame_stream("webp", quality, HEIGHT, WIDTH), moving_square(3)
        packets = [stream.encode(stack[None]) for stack in frames]
        error = (stream.decode(packets[-1]).float() - frames[-1].float()).abs().mean().item()
        sent.append((sum(int(payload_bits(packet)) for packet in packets), error))
    (many, close), (few, far) = sent
    assert few < many and close < far < 10


def shown_and_bits(video: H264, frames: torch.Tensor) -> tuple[torch.Tensor, list[int]]:
    shown, packets = video.send(frames)
    return shown, [8 * len(packet) for packet in packets]


def test_video_needs_few_bits_after_its_key_frame_and_shows_the_frame():
    pytest.importorskip("av")
    video, frames = H264(20, HEIGHT, WIDTH), moving_square(6)[:, 1]
    video.start(2)
    sent = [shown_and_bits(video, torch.stack((frame, 255 - frame))) for frame in frames]
    for (shown, _), frame in zip(sent, frames, strict=True):
        assert (shown[0].float() - frame.float()).abs().mean() < 6
        assert (shown[1].float() + frame.float() - 255).abs().mean() < 6
    bits = torch.tensor([count for _, count in sent]).double()
    assert (bits[1:].mean(0) < bits[0] / 2).all()


def test_video_without_loss_shows_the_frames_but_for_their_halved_colours():
    av = pytest.importorskip("av")
    video, frames = H264(0, HEIGHT, WIDTH), moving_square(3)[:, 1]
    video.start(1)
    for frame in frames:
        halved = av.VideoFrame.from_ndarray(frame.numpy(), format="rgb24").reformat(format="yuv420p")
        shown, (bits,) = shown_and_bits(video, frame[None])
        assert torch.equal(shown[0], torch.from_numpy(halved.to_ndarray(format="rgb24")))
        assert 0 < bits < FRAME_BITS


def test_supplemental_information_is_not_counted():
    unit = b"\x00\x00\x01"
    stream = b"\x00" + unit + b"\x67ab" + unit + b"\x06name" + unit + b"\x65picture"
    assert without_sei(stream) == unit + b"\x67ab" + unit + b"\x65picture"
