"""Codecs: the bits are those of the real packet, and the receiver gets what they carry."""

import numpy as np
import pytest
import torch

from tsjepa.radio.codecs import AffineCodec, FloatCodec, ImageCodec, RawFrameCodec, make_codec, payload_bits


@pytest.fixture
def embeddings():
    return torch.randn(50, 7, generator=torch.Generator().manual_seed(0))


@pytest.fixture
def frames():
    """A dark pole on a smooth background, two frames."""
    frames = torch.full((3, 2, 64, 128, 3), 180, dtype=torch.uint8)
    frames[..., 10:40, 60:64, :] = 30
    frames[:, 1, 10:40, 64:68, 0] = 200
    return frames


def test_float_codecs(embeddings):
    packets = FloatCodec(32).encode(embeddings)
    assert packets.dtype == torch.uint8 and packets.shape == (50, 28)
    assert packets[3].numpy().tobytes() == embeddings[3].numpy().tobytes()
    assert payload_bits(packets).tolist() == [224] * 50
    assert torch.equal(FloatCodec(32).decode(packets), embeddings)
    half = FloatCodec(16)
    assert payload_bits(half.encode(embeddings))[0] == 112
    assert torch.equal(half.decode(half.encode(embeddings)), embeddings.half().float())


@pytest.mark.parametrize("bits", [8, 4])
def test_affine_codec_is_within_half_a_step(embeddings, bits):
    codec = AffineCodec(7, bits).fit(embeddings)
    packets = codec.encode(embeddings)
    assert payload_bits(packets)[0] == (56 if bits == 8 else 32)
    step = (embeddings.amax(0) - embeddings.amin(0)) / (2**bits - 1)
    error = (codec.decode(packets) - embeddings).abs()
    assert (error <= 0.5001 * step).all()
    assert error.max() > 0.3 * step.min()


def test_four_bit_numbers_share_a_byte():
    codec = AffineCodec(3, 4).fit(torch.tensor([[0.0, 0, 0], [15, 15, 15]]))
    assert codec.encode(torch.tensor([[1.0, 2, 15]])).tolist() == [[0x12, 0xF0]]
    assert codec.decode(torch.tensor([[0x12, 0xF0]], dtype=torch.uint8)).tolist() == [[1.0, 2.0, 15.0]]


def test_affine_codec_saturates_and_keeps_constants():
    codec = AffineCodec(2, 8).fit(torch.tensor([[-1.0, 3.0], [1.0, 3.0]]))
    decoded = codec.decode(codec.encode(torch.tensor([[-9.0, 3.0], [9.0, 7.0]])))
    torch.testing.assert_close(decoded[:, 0], torch.tensor([-1.0, 1.0]))
    assert decoded[0, 1] == 3.0


def test_affine_ranges_are_saved(embeddings):
    codec = AffineCodec(7).fit(embeddings)
    copy = AffineCodec(7)
    with pytest.raises(ValueError, match="no ranges yet"):
        copy.encode(embeddings)
    copy.load_state_dict(codec.state_dict())
    assert torch.equal(copy.encode(embeddings), codec.encode(embeddings))


def test_raw_frames(frames):
    codec = RawFrameCodec()
    packets = codec.encode(frames)
    assert payload_bits(packets).tolist() == [2 * 64 * 128 * 3 * 8] * 3
    assert torch.equal(codec.decode(packets), frames)


def test_png_is_lossless_and_smaller(frames):
    codec = ImageCodec("png")
    packets = codec.encode(frames)
    assert all(packet.startswith(b"\x89PNG") for packet in packets)
    assert torch.equal(codec.decode(packets), frames)
    assert payload_bits(packets).tolist() == [8 * len(p) for p in packets]
    assert payload_bits(packets).max() < 393216 / 20


@pytest.mark.parametrize("kind, magic", [("jpeg", b"\xff\xd8"), ("webp", b"RIFF")])
def test_lossy_images_are_close_and_smaller_with_less_quality(frames, kind, magic):
    codec = ImageCodec(kind, quality=80)
    packets = codec.encode(frames)
    assert packets[0].startswith(magic)
    difference = codec.decode(packets).numpy().astype(np.int16) - frames.numpy().astype(np.int16)
    assert np.abs(difference).mean() < 3
    assert payload_bits(ImageCodec(kind, quality=10).encode(frames)).sum() < payload_bits(packets).sum()


def test_empty_batches():
    for name in ("fp32", "fp16", "int8", "int4"):
        codec = make_codec(name, dimension=4)
        if isinstance(codec, AffineCodec):
            codec.fit(torch.randn(9, 4))
        packets = codec.encode(torch.empty(0, 4))
        assert payload_bits(packets).shape == (0,) and codec.decode(packets).shape == (0, 4)
    codec = make_codec("png")
    packets = codec.encode(torch.empty(0, 2, 64, 128, 3, dtype=torch.uint8))
    assert payload_bits(packets).shape == (0,) and codec.decode(packets).shape == (0, 2, 64, 128, 3)


def test_bad_input_is_rejected(frames):
    with pytest.raises(ValueError, match="unknown codec 'mp3'"):
        make_codec("mp3")
    with pytest.raises(ValueError, match="16 and 32"):
        FloatCodec(64)
    with pytest.raises(ValueError, match="4 and 8"):
        AffineCodec(3, 2)
    with pytest.raises(ValueError, match="unknown image format"):
        ImageCodec("gif")
    with pytest.raises(ValueError, match="quality 0"):
        ImageCodec("jpeg", quality=0)
    with pytest.raises(ValueError, match="uint8 frames"):
        RawFrameCodec().encode(frames.float())
    with pytest.raises(ValueError, match="not finite"):
        FloatCodec(16).encode(torch.tensor([[1e6]]))
    with pytest.raises(ValueError, match="not finite"):
        AffineCodec(1).fit(torch.tensor([[0.0], [1.0]])).encode(torch.tensor([[float("nan")]]))
    with pytest.raises(ValueError, match="vectors"):
        FloatCodec().encode(frames)
    with pytest.raises(ValueError, match="fit needs"):
        AffineCodec(2).fit(torch.randn(4, 3))
