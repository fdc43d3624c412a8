"""Chains of transforms that several tests run, at a mean SNR of 8 dB where a link fails now and then."""

import torch
from linear_fleet import A, B, render

from tsjepa.envs.transforms import (
    Camera,
    Channel,
    Codec,
    Encode,
    Estimator,
    HoldCommand,
    Scheduler,
    Uplink,
    linear_model,
)
from tsjepa.radio.codecs import AffineCodec, FloatCodec


def camera():
    return Camera(render, (4, 8), frame_stack=2, frame_spacing=2)


def embed(pixels):
    return pixels.flatten(1)[:, ::16].float() / 100


def integer_codec(dimension):
    return AffineCodec(dimension).fit(torch.tensor([[-1.0], [1.0]]).expand(2, dimension))


def whole_chain(scheduler=None, seed=0):
    return [
        Channel(snr_target_db=8.0, seed=seed),
        scheduler or Scheduler("channel_aware", resource_blocks=2),
        camera(),
        Encode(embed, 12),
        Codec(integer_codec(12)),
        Uplink(),
        Estimator(lambda z, u: 0.9 * z + 0.01 * u),
        HoldCommand(),
    ]


def state_chain(scheduler=None, channel=None, **uplink):
    return [
        channel or Channel(snr_target_db=8.0),
        scheduler or Scheduler("channel_aware", resource_blocks=2),
        Codec(FloatCodec(), in_key="state"),
        Uplink(**uplink),
        Estimator(linear_model(A, B)),
    ]
