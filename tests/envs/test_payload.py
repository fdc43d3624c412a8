"""What an update is sent as: codecs, their ranges, and the bits to reserve."""

from __future__ import annotations

import pytest
import torch
from tiny_controller import tiny, tiny_autoencoder
from torch.nn import functional as F

from tsjepa.envs import Radio
from tsjepa.envs.payload import (
    codec_bits,
    embedding_codec,
    frame_codec,
    sends_frames,
    state_codec,
    update_bits,
    update_codec,
)
from tsjepa.plants import CartPole, Reacher
from tsjepa.radio.codecs import payload_bits

D = 8


@pytest.fixture(scope="module")
def model():
    model = tiny()
    model.code_low.fill_(-0.5)
    model.code_high.fill_(0.75)
    return model


@pytest.mark.parametrize(("name", "bits", "step"), [("fp32", 32, 0), ("fp16", 16, 2**-11), ("int8", 8, 1.25 / 255)])
def test_what_is_received_is_what_was_sent_to_within_half_a_step_and_of_unit_length(model, name, bits, step):
    codec = embedding_codec(name, model)
    sent = F.normalize(torch.rand(50, D, generator=torch.Generator().manual_seed(1)) - 0.2, dim=-1)
    sent = sent[(sent > -0.5).all(1) & (sent < 0.75).all(1)]
    assert len(sent) > 20
    packets = codec.encode(sent)
    received = codec.decode(packets)
    assert (payload_bits(packets) == bits * D).all()
    torch.testing.assert_close(received.norm(dim=-1), torch.ones(len(sent)))
    # the length of what is decoded is off by at most half a step per dimension, times the square root of d
    assert ((received - sent).norm(dim=-1) <= step * D**0.5 + 1e-6).all()


def test_a_model_without_ranges_says_what_to_do(model):
    bare = tiny()
    bare.code_low.fill_(float("nan"))
    for name in ("int8", "int4"):
        with pytest.raises(ValueError, match=rf"codec {name} needs ranges.*FitCodec"):
            embedding_codec(name, bare)
    embedding_codec("fp16", bare)


@pytest.mark.parametrize("plant", [CartPole(), Reacher()], ids=["cart-pole", "reacher"])
def test_an_integer_state_covers_the_plants_scale(plant):
    codec, scale = state_codec("int8", plant.spec), torch.tensor(plant.spec.state_scale)
    edges = torch.stack((-scale, scale, 0.3 * scale))
    received = codec.decode(codec.encode(edges))
    assert ((received - edges).abs() <= scale / 255 * 1.01).all()
    assert (payload_bits(codec.encode(edges)) == 8 * plant.spec.state_dim).all()


@pytest.mark.parametrize(
    ("codec", "with_model", "bits"),
    [("fp32", True, 32 * D), ("int4", True, 4 * D), ("fp32", False, 32 * 4), ("fp16", False, 16 * 4)],
)
def test_bits_to_reserve_follow_from_the_codec(model, codec, with_model, bits):
    radio, spec, sender = Radio(resource_blocks=None, codec=codec), CartPole().spec, model if with_model else None
    chosen = update_codec(radio, spec, sender)
    assert update_bits(radio, spec, sender, chosen) == codec_bits(radio, spec, sender, chosen) == bits
    assert update_bits(Radio(resource_blocks=None, codec=codec, payload_bits=7), spec, sender, chosen) == 7
    assert update_bits(Radio(resource_blocks=3, codec=codec), spec, sender, chosen) is None


def test_raw_frames_are_counted_whole(model):
    radio, spec = Radio(resource_blocks=None, codec="raw"), CartPole().spec
    assert update_bits(radio, spec, model, update_codec(radio, spec, model)) == 2 * 64 * 128 * 3 * 8


def test_packets_of_no_fixed_length_ask_for_a_reservation(model):
    radio, spec = Radio(resource_blocks=None, codec="jpeg"), CartPole().spec
    with pytest.raises(ValueError, match=r"vary in length: give radio\.payload_bits"):
        update_bits(radio, spec, model, update_codec(radio, spec, model))


def test_frames_need_a_model_and_streams_neighbouring_frames(model):
    with pytest.raises(ValueError, match="need the encoder of a model"):
        update_codec(Radio(codec="png"), CartPole().spec, None)
    apart = tiny(frame_spacing=2)
    with pytest.raises(ValueError, match="neighbouring frames"):
        frame_codec("stream-jpeg", apart)
    frame_codec("stream-jpeg", model)
    assert sends_frames("stream-h264") and sends_frames("webp") and not sends_frames("fp16")


def test_the_autoencoders_embedding_is_sent_like_any_other():
    model = tiny_autoencoder()
    codec = embedding_codec("fp32", model)
    sent = F.normalize(torch.ones(2, D), dim=-1)
    torch.testing.assert_close(codec.decode(codec.encode(sent)), sent)
