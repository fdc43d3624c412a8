"""One retransmission against Monte-Carlo, joules by hand, and interference as a rise over thermal."""

import math

import pytest
import torch

from tsjepa.radio.energy import energy_per_update
from tsjepa.radio.fading import rayleigh_power
from tsjepa.radio.harq import residual_outage
from tsjepa.radio.link import outage_probability, sinr


@pytest.mark.parametrize("means", [(10.0, 10.0), (10.0, 3.0), (1.0, 20.0), (5.0, 5.0 + 1e-9)])
@pytest.mark.parametrize("threshold", [0.5, 10**0.5, 20.0])
def test_residual_outage_agrees_with_monte_carlo(means, threshold):
    draws = 400_000
    device, slot = torch.arange(draws), torch.tensor(0)
    first, second = (mean * rayleigh_power(5, device, slot, torch.tensor(k)) for k, mean in enumerate(means))
    expected = residual_outage(threshold, *means).item()
    realised = (first + second < threshold).double().mean().item()
    assert abs(realised - expected) <= 3 * math.sqrt(expected * (1 - expected) / draws)


def test_residual_outage_at_its_ends():
    assert residual_outage(0.0, 1.0, 2.0).item() == 0.0
    assert residual_outage(3.0, 10.0, 10.0).item() == pytest.approx(1 - 1.3 * math.exp(-0.3), abs=1e-12)
    # close means, where a difference of exponentials would cancel
    near = residual_outage(3.0, 10.0, 10.0 * (1 + 1e-10)).item()
    assert near == pytest.approx(1 - 1.3 * math.exp(-0.3), abs=1e-9)
    # a second attempt that is never heard is no attempt
    assert residual_outage(3.0, 10.0, 1e-12).item() == pytest.approx(outage_probability(3.0, 10.0).item(), abs=1e-9)
    torch.testing.assert_close(residual_outage(3.0, 2.0, 7.0), residual_outage(3.0, 7.0, 2.0))
    with pytest.raises(ValueError, match="linear"):
        residual_outage(3.0, 0.0, 1.0)


def test_energy_worked_by_hand():
    """23 dBm are 199.5 mW; 2 ms at an efficiency of .25, 100 mW of circuit, 5 mJ of encoder."""
    joules = energy_per_update(23.0, 2e-3, encode_j=5e-3, circuit_w=0.1, amplifier_efficiency=0.25)
    assert joules.item() == pytest.approx(5e-3 + 2e-3 * (0.199526 / 0.25 + 0.1), abs=1e-8)
    assert energy_per_update(torch.tensor([30.0, 0.0]), 1.0).tolist() == pytest.approx([1.0, 1e-3])
    with pytest.raises(ValueError, match="amplifier_efficiency 0"):
        energy_per_update(23.0, 1e-3, amplifier_efficiency=0.0)
    with pytest.raises(ValueError, match="at least 0"):
        energy_per_update(23.0, -1.0)


def test_interference_as_strong_as_the_noise_costs_three_decibels():
    rise = 10 * math.log10(2)
    torch.testing.assert_close(sinr(torch.tensor([10.0, 4.0]), rise), torch.tensor([5.0, 2.0]))
    with pytest.raises(ValueError, match="rise over thermal"):
        sinr(torch.ones(1), -1.0)
