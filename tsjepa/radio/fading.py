"""Small-scale fading: the power gain |H|^2 of each device in each slot, mean 1."""

import math

import torch
from torch import Tensor

from tsjepa.radio.streams import normal, uniform

NUM_PATHS = 16


def rayleigh_power(seed: int, device: Tensor, episode: Tensor, slot: Tensor, stream: str = "fading") -> Tensor:
    """Rayleigh block fading, independent from slot to slot: |H|^2 is exponential with mean 1.

    Args:
        seed: seed of the fading stream.
        device, episode, slot: int64 counters that broadcast together.
        stream: of the random numbers; "repetition" for a packet that is sent again within the slot.

    Returns:
        float64, the broadcast shape.
    """
    return -torch.log(uniform(seed, stream, device, episode, slot))


def jakes_gain(
    seed: int, device: Tensor, episode: Tensor, time_s: Tensor, max_doppler_hz: float
) -> tuple[Tensor, Tensor]:
    """Rayleigh fading with Clarke's (Jakes') spectrum, as a sum of ``NUM_PATHS`` plane waves.

    The wave amplitudes are complex Gaussian, so that H is exactly complex Gaussian at every instant, and the angles of
    arrival are evenly spaced with a random offset, so that E[H(t) H*(t + tau)] = J0(2 pi f_D tau).

    Args:
        seed: seed of the fading stream.
        device, episode: int64 counters; a device keeps its waves during an episode.
        time_s: time since the start of the episode, broadcast against the counters.
        max_doppler_hz: f_D.

    Returns:
        Real and imaginary part of H, float64, the broadcast shape; |H|^2 has mean 1.
    """
    device, episode, time_s = device.unsqueeze(-1), episode.unsqueeze(-1), time_s.unsqueeze(-1)
    path = torch.arange(NUM_PATHS, device=device.device)
    offset = uniform(seed, "fading", device, episode, torch.full_like(path[:1], -1))
    angle = 2 * math.pi * (path + offset) / NUM_PATHS
    scale = math.sqrt(0.5 / NUM_PATHS)
    a = scale * normal(seed, "fading", device, episode, 2 * path)
    b = scale * normal(seed, "fading", device, episode, 2 * path + 1)
    phase = 2 * math.pi * max_doppler_hz * time_s.to(torch.float64) * torch.cos(angle)
    cosine, sine = torch.cos(phase), torch.sin(phase)
    return (a * cosine - b * sine).sum(-1), (a * sine + b * cosine).sum(-1)
