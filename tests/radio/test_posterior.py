"""Success given knowledge: printed reference numbers, scipy's noncentral chi-square, and Monte-Carlo."""

import math

import pytest
import torch
from scipy.stats import ncx2

from tsjepa.radio.posterior import (
    delayed_success,
    expected_snr,
    fading_correlation,
    marcum_q1,
    statistical_success,
    success_after,
)

THRESHOLD = 10**0.5
RHO = 0.614904  # one slot of 20 ms at 10.4239 Hz


def double(*values):
    return torch.tensor(values, dtype=torch.float64)


def test_reference_numbers():
    assert f"{fading_correlation(0.02, 10.4239).item():.6f}" == "0.614904"
    old = double(0.1, 1.0, 3.16228, 10.0, 31.6228)
    success = delayed_success(THRESHOLD, double(10.0), old, fading_correlation(0.02, 10.4239))
    assert [f"{p:.6f}" for p in success.tolist()] == ["0.603257", "0.619579", "0.656170", "0.750719", "0.911228"]
    independent = delayed_success(THRESHOLD, double(10.0), old, 0.0)
    assert [f"{p:.6f}" for p in independent.tolist()] == ["0.728893"] * 5


def test_correlation_is_j0_and_vanishes_for_independent_fading():
    # the first zeros of J0, and its value at 1 (Abramowitz and Stegun, tables 9.5 and 9.1)
    argument = double(2.4048255577, 5.5200781103, 1.0) / (2 * math.pi * 10.4239)
    torch.testing.assert_close(fading_correlation(argument, 10.4239), double(0, 0, 0.7651976866), rtol=0, atol=1e-10)
    assert fading_correlation(double(0.0, 0.02), 0.0).tolist() == [1.0, 0.0]
    with pytest.raises(ValueError, match="at least 0"):
        fading_correlation(-0.1, 10.0)


def test_marcum_q_matches_scipy():
    grid = torch.cat([double(0.0), torch.logspace(-4, 1.1, 80).double(), torch.linspace(0.1, 12, 120).double()])
    a, b = torch.meshgrid(grid, grid, indexing="ij")
    expected = torch.from_numpy(ncx2.sf(b.numpy() ** 2, 2, a.numpy() ** 2))
    assert (marcum_q1(a, b) - expected).abs().max() < 1e-12


def test_marcum_q_at_its_ends():
    x = double(0.0, 0.3, 3.0, 50.0)
    torch.testing.assert_close(marcum_q1(torch.zeros(4), x), torch.exp(-(x**2) / 2))
    assert marcum_q1(x, torch.zeros(4)).tolist() == [1.0] * 4
    # Q1(a, a) = (1 + exp(-a^2) I0(a^2)) / 2, which no series converges to for large a
    large = double(1.0, 30.0, 3000.0)
    torch.testing.assert_close(marcum_q1(large, large), (1 + torch.special.i0e(large**2)) / 2, rtol=1e-11, atol=0)


@pytest.mark.parametrize("rho", [0.0, 0.3, RHO, 0.95, 0.999])
@pytest.mark.parametrize("mean", [1.0, 10.0])
@pytest.mark.parametrize("threshold", [0.5, THRESHOLD, 20.0])
def test_delayed_success_agrees_with_monte_carlo(rho, mean, threshold):
    """Gains that are complex Gaussian around rho times the old one, for three old SNRs."""
    draws = 100_000
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(2, draws, generator=generator, dtype=torch.float64) * math.sqrt((1 - rho**2) * mean / 2)
    for old in (0.0, 0.4 * mean, 3.0 * mean):
        expected = delayed_success(threshold, double(mean), double(old), rho).item()
        snr = (rho * math.sqrt(old) + noise[0]) ** 2 + noise[1] ** 2
        realised = (snr >= threshold).double().mean().item()
        assert abs(realised - expected) <= 3 * math.sqrt(expected * (1 - expected) / draws) + 1e-12
        error = (snr.std() / math.sqrt(draws)).item()
        assert abs(snr.mean().item() - expected_snr(double(mean), double(old), rho).item()) <= 3 * error


def test_the_ends_of_correlation():
    mean, old = double(2.0, 10.0, 40.0), double(50.0, 1.0, 3.5)
    assert torch.equal(delayed_success(THRESHOLD, mean, old, 0.0), statistical_success(THRESHOLD, mean))
    assert delayed_success(THRESHOLD, mean, old, 1.0).tolist() == [1.0, 0.0, 1.0]
    assert delayed_success(THRESHOLD, mean, old, -1.0).tolist() == [1.0, 0.0, 1.0]
    nothing = torch.full_like(mean, -1.0)
    assert torch.equal(delayed_success(THRESHOLD, mean, nothing, RHO), statistical_success(THRESHOLD, mean))
    assert torch.equal(expected_snr(mean, nothing, RHO), mean)


def test_the_delayed_posterior_averages_to_the_statistical_one():
    """Law of total probability over the old SNR."""
    old = -10.0 * torch.log1p(-(torch.arange(200_000) + 0.5) / 200_000).double()
    average = delayed_success(THRESHOLD, double(10.0), old, RHO).mean()
    assert average.item() == pytest.approx(math.exp(-THRESHOLD / 10), abs=1e-5)


@pytest.mark.parametrize("rho", [0.0, 0.3, RHO, -0.4, 0.95])
def test_success_after_an_outcome_agrees_with_monte_carlo(rho):
    draws, h = 400_000, 0.316
    generator = torch.Generator().manual_seed(2)
    then, noise = torch.randn(2, 2, draws, generator=generator, dtype=torch.float64) / math.sqrt(2)
    now = rho * then + math.sqrt(1 - rho**2) * noise
    above_then, above_now = ((gain**2).sum(0) >= h for gain in (then, now))
    for outcome in (True, False):
        expected = success_after(h, double(1.0), double(float(outcome)), rho).item()
        chosen = above_now[above_then == outcome].double()
        assert abs(chosen.mean().item() - expected) <= 3 * math.sqrt(expected * (1 - expected) / len(chosen))


def test_success_after_an_outcome_at_its_ends():
    mean = double(1.0, 10.0)
    assert success_after(THRESHOLD, mean, double(1.0, 0.0), 1.0).tolist() == [1.0, 0.0]
    alone = statistical_success(THRESHOLD, mean)
    assert torch.equal(success_after(THRESHOLD, mean, double(1.0, 0.0), 0.0), alone)
    torch.testing.assert_close(success_after(THRESHOLD, mean, alone, RHO), alone)
