"""Prediction of fading gains: closed forms for one and two measurements, and drawn gains."""

import pytest
import torch
from scipy.special import j0

from tsjepa.radio.belief import DelayedCsi, PredictedCsi, make_belief
from tsjepa.radio.fading import jakes_gain
from tsjepa.radio.posterior import delayed_success
from tsjepa.radio.prediction import gain_predictor, predicted_success

WALK_HZ, SLOT_S = 10.4239, 0.02
RHO, RHO_2 = (float(j0(2 * torch.pi * WALK_HZ * SLOT_S * lag)) for lag in (1, 2))


def test_one_and_two_measurements_by_hand():
    weights, left = gain_predictor(3, 1, WALK_HZ, SLOT_S)
    assert weights[0].tolist() == [0, 0, 0] and left[0] == 1
    assert weights[1].tolist() == pytest.approx([RHO, 0, 0], abs=1e-5)
    assert left[1].item() == pytest.approx(1 - RHO**2, abs=1e-5)
    determinant = 1 - RHO**2
    a, b = RHO * (1 - RHO_2) / determinant, (RHO_2 - RHO**2) / determinant
    assert weights[2].tolist() == pytest.approx([a, b, 0], abs=1e-5)
    assert left[2].item() == pytest.approx(1 - a * RHO - b * RHO_2, abs=1e-5)


def test_the_error_of_drawn_gains_has_the_variance_that_is_left():
    device, slot = torch.arange(40_000).unsqueeze(-1), torch.arange(8)
    gain = torch.complex(*jakes_gain(3, device, torch.tensor(0), slot * SLOT_S, WALK_HZ))
    for lags, delay in ((1, 1), (2, 1), (4, 1), (4, 3)):
        weights, left = gain_predictor(lags, delay, WALK_HZ, SLOT_S)
        past = gain[:, : 8 - delay].flip(-1)[:, :lags]
        error = gain[:, 7] - (past * weights[lags]).sum(-1)
        assert error.abs().square().mean().item() == pytest.approx(left[lags].item(), rel=0.04)


def test_slow_fading_can_be_solved():
    weights, left = gain_predictor(6, 1, 0.05, SLOT_S)
    assert weights.isfinite().all() and weights.abs().max() < 100
    assert (left.diff() <= 1e-9).all() and left[6] < 1e-4


def test_one_measurement_is_the_law_of_one_old_snr():
    old = torch.tensor([0.1, 1.0, 10**0.5, 10.0, 31.6228], dtype=torch.float64)
    mean = torch.full_like(old, 10.0)
    left = torch.full_like(old, 1 - RHO**2)
    found = predicted_success(10**0.5, mean, RHO**2 * old / mean, left)
    torch.testing.assert_close(found, delayed_success(10**0.5, mean, old, RHO), atol=1e-12, rtol=0)


@pytest.mark.parametrize("delay", [1, 2])
def test_without_phases_it_believes_what_one_old_snr_says(delay):
    """Outcomes aside: nothing is sent."""
    one, other = PredictedCsi(3.0, None, WALK_HZ, delay=delay), DelayedCsi(3.0, None, WALK_HZ, delay=delay)
    memories, silent = [one.start((4,)), other.start((4,))], torch.zeros(4, dtype=torch.bool)
    mean, generator = torch.full((4,), 8.0), torch.Generator().manual_seed(0)
    for _ in range(6):
        snr = 8 * torch.rand(4, generator=generator)
        (memories[0], a), (memories[1], b) = (
            kind.step(memory, mean, snr, silent, silent) for kind, memory in zip((one, other), memories, strict=True)
        )
        torch.testing.assert_close(a.success, b.success, atol=1e-5, rtol=0)
        torch.testing.assert_close(a.snr, b.snr, atol=1e-4, rtol=0)


def test_it_is_what_delayed_knowledge_of_correlated_fading_means():
    assert isinstance(make_belief("delayed", 1.0, max_doppler_hz=5.0), PredictedCsi)
    assert type(make_belief("delayed", 1.0)) is DelayedCsi
