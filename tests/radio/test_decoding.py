"""Probabilities of decoding against closed forms and drawn fading, with block error curves and with a repetition."""

import math

import pytest
import torch
from scipy.special import j0

from tsjepa.radio.decoding import Decoding, as_decoding
from tsjepa.radio.fading import jakes_gain
from tsjepa.radio.harq import residual_outage
from tsjepa.radio.link import resource_units
from tsjepa.radio.links import McsLink, ShannonLink
from tsjepa.radio.mcs import block_error_rate
from tsjepa.radio.posterior import delayed_success, statistical_success, success_after

THRESHOLD, MEAN = 10**0.5, torch.full((4,), 10.0, dtype=torch.float64)
OLD = torch.tensor([0.1, 1.0, 5.0, 30.0], dtype=torch.float64)


def test_a_sharp_threshold_is_what_the_posteriors_say():
    sharp = as_decoding(THRESHOLD)
    assert sharp.given_snr(OLD, MEAN).tolist() == [0, 0, 1, 1]
    assert torch.equal(sharp.given_mean(MEAN), statistical_success(THRESHOLD, MEAN))
    assert torch.equal(sharp.given_old(MEAN, OLD, 0.6), delayed_success(THRESHOLD, MEAN, OLD, 0.6))
    assert torch.equal(sharp.given_outcome(MEAN, OLD / 30, 0.6), success_after(THRESHOLD, MEAN, OLD / 30, 0.6))


def test_a_repetition_of_independent_fading_leaves_the_residual_outage():
    twice = Decoding((THRESHOLD,), repetition=0.0)
    torch.testing.assert_close(twice.given_mean(MEAN), 1 - residual_outage(THRESHOLD, MEAN, MEAN), atol=1e-8, rtol=0)
    # an older SNR that says nothing leaves the same, up to the cells of the sum
    torch.testing.assert_close(twice.given_old(MEAN, OLD, 0.0), twice.given_mean(MEAN), atol=2e-4, rtol=0)
    missing = torch.clamp(THRESHOLD - OLD, min=0) / 10
    torch.testing.assert_close(twice.given_snr(OLD, MEAN), torch.exp(-missing))


def test_a_repetition_of_correlated_fading_against_drawn_gains():
    doppler_hz, device = 10.4239, torch.arange(200_000).unsqueeze(-1)
    time = torch.tensor([0.0, 0.02, 0.028], dtype=torch.float64)
    power = torch.stack(jakes_gain(1, device, torch.tensor(0), time, doppler_hz)).square().sum(0) * 10.0
    arrives = (power[:, 1] + power[:, 2] >= THRESHOLD).double()
    again = float(j0(2 * math.pi * doppler_hz * 0.008))
    twice = Decoding((THRESHOLD,), repetition=again)
    expected = twice.given_mean(MEAN[:1]).item()
    assert arrives.mean().item() == pytest.approx(expected, abs=4 * math.sqrt(expected * (1 - expected) / 200_000))
    rho = float(j0(2 * math.pi * doppler_hz * 0.02))
    for old in (0.5, 4.0, 15.0):
        near = (power[:, 0] / old - 1).abs() < 0.1
        predicted = twice.given_old(MEAN[:1], torch.tensor([old]), rho).item()
        # the phases, which link the three instants further, are not known
        assert arrives[near].mean().item() == pytest.approx(predicted, abs=0.02)


def test_a_block_error_curve_is_a_drawn_threshold():
    link = McsLink(5)
    drawn = Decoding(link.thresholds(256))
    assert list(drawn.thresholds) == sorted(drawn.thresholds) and len(drawn.thresholds) == 16
    snr = 10 ** torch.linspace(-1, 2, 400, dtype=torch.float64)
    decoded = 1 - block_error_rate(5, snr, 256)
    assert (drawn.given_snr(snr, snr) - decoded).abs().max() <= 1 / 16
    # the mean over Rayleigh fading, by the trapezoid rule over its density
    grid = torch.linspace(1e-4, 200, 400_001, dtype=torch.float64)
    expected = torch.trapezoid((1 - block_error_rate(5, grid, 256)) * torch.exp(-grid / 10) / 10, grid)
    assert drawn.given_mean(MEAN)[0].item() == pytest.approx(expected.item(), abs=1e-3)


def test_units_are_those_of_the_smallest_transport_block_that_is_large_enough():
    """Transport blocks of 888 (MCS 28, one unit) and 2088 bits (MCS 10, ten units), as in the standard's tables."""
    snr = torch.full((4,), 1e3, dtype=torch.float64)
    bits = torch.tensor([0, 1, 888, 889])
    assert McsLink(28).units(bits, snr).tolist() == [0, 1, 1, 2]
    assert McsLink(10).units(torch.tensor([2088, 2089, 1, 0]), snr).tolist() == [10, 11, 1, 0]
    assert McsLink(0).units(10**7, snr[:1]).item() == 2**31 - 1


def test_an_adapted_mcs_meets_its_target_and_needs_fewer_units_at_higher_snr():
    link, snr = McsLink(None), 10 ** torch.linspace(0.3, 2.5, 50, dtype=torch.float64)
    assert (link.error_rate(1000, snr) <= 0.1).all()
    units = link.units(1000, snr)
    assert (units.diff() <= 0).all() and units[0] == 3 * units[-1] == 6


def test_a_gap_is_a_lower_snr():
    snr = torch.tensor([2.0, 10.0, 50.0], dtype=torch.float64)
    assert torch.equal(ShannonLink(3.0).units(5000, snr), resource_units(5000, snr / 10**0.3))
    assert torch.equal(ShannonLink().units(5000, snr), resource_units(5000, snr))


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: ShannonLink(-1.0), "gap_db -1"),
        (lambda: McsLink(29), "mcs 29"),
        (lambda: McsLink(3, target=1.0), "target"),
    ],
)
def test_bad_input_is_rejected(make, named):
    with pytest.raises(ValueError, match=named):
        make()
