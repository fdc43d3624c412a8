"""What a device puts on the air: bits of the real packets, and what the controller makes of them."""

import pytest
import torch

from tsjepa.paper.senders import H264, StackSender, Stills, StreamSender, make_sender, without_sei
from tsjepa.radio.codecs import make_codec

FRAME_BITS = 64 * 128 * 3 * 8


class Stacker:
    """A model whose embedding is the mean of each frame of its stack."""

    def encode(self, frames):
        return frames.double().mean((2, 3, 4))


def moving_square(slots: int) -> torch.Tensor:
    """uint8 [slots, 2, 64, 128, 3]: neighbouring frames of a square that moves and brightens."""
    frames = torch.zeros(slots + 1, 64, 128, 3, dtype=torch.uint8)
    for slot in range(slots + 1):
        frames[slot, 20:40, 10 + slot : 40 + slot] = 100 + 5 * slot
    return torch.stack((frames[:-1], frames[1:]), 1)


def test_a_stream_of_single_frames_gives_the_stacks():
    sender, frames = StreamSender(Stacker(), Stills(make_codec("raw", frame_stack=1))), moving_square(4)
    for slot, stack in enumerate(frames):
        embedding, bits = sender.send(stack[None], slot == 0)
        assert torch.equal(embedding, Stacker().encode(stack[None]))
        assert bits.tolist() == [(2 if slot == 0 else 1) * 64 * 128 * 3 * 8]


def test_video_needs_few_bits_after_its_key_frame_and_shows_the_frame():
    pytest.importorskip("av")
    video, frames = H264(20), moving_square(6)[:, 1]
    video.start(2)
    sent = [video.send(torch.stack((frame, 255 - frame))) for frame in frames]
    assert all(
        (shown[0].float() - frame.float()).abs().mean() < 6 for (shown, _), frame in zip(sent, frames, strict=True)
    )
    assert all(
        (shown[1].float() + frame.float() - 255).abs().mean() < 6
        for (shown, _), frame in zip(sent, frames, strict=True)
    )
    bits = torch.stack([count for _, count in sent])
    assert (bits[1:].double().mean(0) < bits[0] / 2).all()


def test_supplemental_information_is_not_counted():
    unit = b"\x00\x00\x01"
    stream = b"\x00" + unit + b"\x67ab" + unit + b"\x06name" + unit + b"\x65picture"
    assert without_sei(stream) == unit + b"\x67ab" + unit + b"\x65picture"


@pytest.mark.parametrize("codec", ["raw", "png"])
def test_lossless_stills_arrive_bit_by_bit(codec):
    frames = moving_square(5)
    stack, stream = make_codec(codec, frame_stack=2), StreamSender(Stacker(), Stills(make_codec(codec, frame_stack=1)))
    assert torch.equal(stack.decode(stack.encode(frames)), frames)
    embedding, bits = StackSender(Stacker(), stack).send(frames, True)
    assert torch.equal(embedding, Stacker().encode(frames))
    assert bits.tolist() == [8 * len(packet) for packet in stack.encode(frames)]
    assert (bits == 2 * FRAME_BITS).all() if codec == "raw" else (bits < 2 * FRAME_BITS / 50).all()
    for slot, pair in enumerate(frames):
        assert torch.equal(stream.send(pair[None], slot == 0)[0], Stacker().encode(pair[None]))


@pytest.mark.parametrize("codec", ["raw", "png"])
def test_in_a_slot_without_updates_nothing_is_sent(codec):
    codec = make_codec(codec, frame_stack=2)
    nothing = moving_square(1)[:0]
    assert codec.decode(codec.encode(nothing)).shape == nothing.shape


def test_a_lower_quality_needs_fewer_bits_and_shows_the_frames_less_well():
    frames = moving_square(3)
    sent = []
    for quality in (90, 10):
        codec = make_codec("webp", quality=quality, frame_stack=2)
        packets = codec.encode(frames)
        error = (codec.decode(packets).float() - frames.float()).abs().mean().item()
        _, bits = StackSender(Stacker(), codec).send(frames, True)
        assert bits.tolist() == [8 * len(packet) for packet in packets]
        sent.append((bits.sum().item(), error))
    (many, close), (few, far) = sent
    assert few < many and close < far < 10


def test_video_without_loss_shows_the_frames_but_for_their_halved_colours():
    av = pytest.importorskip("av")
    video, frames = H264(0), moving_square(3)[:, 1]
    video.start(1)
    for frame in frames:
        halved = av.VideoFrame.from_ndarray(frame.numpy(), format="rgb24").reformat(format="yuv420p")
        shown, bits = video.send(frame[None])
        assert torch.equal(shown[0], torch.from_numpy(halved.to_ndarray(format="rgb24")))
        assert 0 < bits.item() < FRAME_BITS


class Squares(Stacker):
    """Stacker with what a sender asks of a model."""

    class architecture:
        frame_stack, frame_spacing, sampling_interval = 2, 2, 0.02


@pytest.mark.parametrize(
    ("sends", "said"), [("smoke", "smoke"), ("stream", "frame_spacing"), ("video", "frame_spacing")]
)
def test_what_cannot_be_sent_is_refused(sends, said):
    with pytest.raises(ValueError, match=said):
        make_sender(Squares(), sends, "png", None)
