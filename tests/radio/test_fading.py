"""Random streams, fading and loss models against their laws."""

import math

import pytest
import torch
from scipy.special import j0
from scipy.stats import kstest

from tsjepa.radio.fading import jakes_gain, rayleigh_power
from tsjepa.radio.loss import GilbertElliott, IidLoss, erased
from tsjepa.radio.streams import normal, uniform

ZERO = torch.tensor(0)
WALK_HZ = 3 / 3.6 * 3.75e9 / 299_792_458  # largest Doppler shift v f / c at 3 km/h and 3.75 GHz


def test_uniform_is_uniform_along_every_counter():
    line = torch.arange(100_000)
    for counters in ((line, ZERO, ZERO), (ZERO, line, ZERO), (ZERO, ZERO, line)):
        assert kstest(uniform(0, "fading", *counters).numpy(), "uniform").pvalue > 1e-3
    assert kstest(normal(5, "shadowing", line).numpy(), "norm").pvalue > 1e-3


def test_neighbouring_counters_seeds_and_streams_are_uncorrelated():
    line = torch.arange(200_000)
    base = uniform(0, "fading", line, ZERO) - 0.5
    others = [
        uniform(0, "fading", line + 1, ZERO),
        uniform(0, "fading", line, ZERO + 1),
        uniform(0, "fading", ZERO, line),
        uniform(1, "fading", line, ZERO),
        uniform(0, "loss", line, ZERO),
    ]
    for other in others:
        correlation = 12 * (base * (other - 0.5)).mean().item()
        assert abs(correlation) < 4 / math.sqrt(line.numel())


def test_uniform_depends_on_the_counters_only():
    table = uniform(7, "fading", torch.arange(6).unsqueeze(-1), torch.arange(4))
    assert table[4, 2] == uniform(7, "fading", torch.tensor(4), torch.tensor(2))
    assert table.unique().numel() == 24
    with pytest.raises(ValueError, match="unknown random stream"):
        uniform(0, "weather", ZERO)


def test_rayleigh_power_is_exponential():
    gain = rayleigh_power(1, torch.arange(100_000), ZERO, ZERO)
    assert kstest(gain.numpy(), "expon").pvalue > 1e-3


@pytest.mark.parametrize("lag_ms", [1.0, 10.0, 20.0, 36.7, 80.0])
def test_jakes_autocorrelation_is_j0(lag_ms):
    device = torch.arange(60_000)
    start, lag = torch.tensor(0.13, dtype=torch.float64), lag_ms * 1e-3
    real, imaginary = jakes_gain(0, device, ZERO, start, WALK_HZ)
    later_real, later_imaginary = jakes_gain(0, device, ZERO, start + lag, WALK_HZ)
    correlation = (real * later_real + imaginary * later_imaginary).mean().item()
    assert correlation == pytest.approx(j0(2 * math.pi * WALK_HZ * lag), abs=0.01)


def test_jakes_fading_has_exponential_power_at_any_instant():
    time = torch.linspace(0, 3, 30_000, dtype=torch.float64)
    real, imaginary = jakes_gain(2, torch.arange(30_000), ZERO, time, 10.0)
    gain = real**2 + imaginary**2
    assert kstest(gain.numpy(), "expon").pvalue > 1e-3


def test_iid_loss_rate():
    loss, device = IidLoss(0.3), torch.arange(100_000)
    bad = loss.advance(loss.start(0, device, ZERO), 0, device, ZERO, ZERO)
    lost = erased(loss.loss_probability(bad), 0, device, ZERO, ZERO)
    assert lost.double().mean().item() == pytest.approx(loss.mean, abs=3 * math.sqrt(0.21 / 1e5))


def test_gilbert_elliott_loss_rate_and_burst_length():
    loss, device = GilbertElliott(good_to_bad=0.05, bad_to_good=0.25, loss_good=0.02, loss_bad=0.8), torch.arange(5000)
    episode = torch.zeros_like(device)
    state = loss.start(0, device, episode)
    states, losses = [], []
    for slot in range(200):
        state = loss.advance(state, 0, device, episode, torch.tensor(slot))
        states.append(state)
        losses.append(erased(loss.loss_probability(state), 0, device, episode, torch.tensor(slot)))
    states, losses = torch.stack(states), torch.stack(losses)
    assert states.double().mean().item() == pytest.approx(1 / 6, abs=0.004)
    assert losses.double().mean().item() == pytest.approx(loss.mean, abs=0.004)
    left = (states[:-1] & ~states[1:]).sum() / states[:-1].sum()
    assert left.item() == pytest.approx(0.25, abs=0.005)


def test_loss_models_reject_bad_probabilities():
    with pytest.raises(ValueError, match="loss probability"):
        IidLoss(1.5)
    with pytest.raises(ValueError, match="bad_to_good"):
        GilbertElliott(0.1, -0.1)
    with pytest.raises(ValueError, match="never moves"):
        GilbertElliott(0.0, 0.0)
