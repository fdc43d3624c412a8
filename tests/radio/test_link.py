"""Link budget, outage and resource units against the reference numbers; Monte-Carlo outage against the closed form."""

import math

import pytest
import torch
from scipy.special import exp1

from tsjepa.radio import (
    capacity,
    ergodic_efficiency,
    outage_probability,
    path_loss_db,
    resource_units,
    units_per_slot,
)
from tsjepa.radio.fading import rayleigh_power
from tsjepa.radio.link import (
    TOTAL_BANDWIDTH_HZ,
    db_to_linear,
    mean_snr,
    noise_dbm,
    tx_power_for_target_dbm,
    unit_bits,
)

DISTANCE_3D = math.hypot(50.0, 8.5)


@pytest.mark.parametrize(
    "power_dbm, snr_db, outages",
    [
        (0, "12.546445", (".161329", ".426708", ".996165")),
        (10, "22.546445", (".0174398", ".0541166", ".426708")),
        (20, "32.546445", (".00175782", ".00554815", ".0541166")),
        (23, "35.546445", (".000881382", ".00278452", ".0274989")),
    ],
)
def test_table_of_outages(power_dbm, snr_db, outages):
    loss = path_loss_db("DH", DISTANCE_3D, 3.75, False)
    snr = mean_snr(loss, power_dbm, TOTAL_BANDWIDTH_HZ)
    assert f"{10 * math.log10(snr):.6f}" == snr_db
    for threshold_db, printed in zip((5.0, 10.0, 20.0), outages, strict=True):
        outage = outage_probability(db_to_linear(threshold_db), snr).item()
        assert f"{outage:.{len(printed) - 1}f}" == f"0{printed}"


def test_noise_scales_with_bandwidth():
    assert noise_dbm(20e6) == -95.0
    assert noise_dbm(180e3) == pytest.approx(-115.457575, abs=5e-7)
    with pytest.raises(ValueError, match="bandwidth"):
        noise_dbm(0.0)


@pytest.mark.parametrize("snr_db, expected", [(5, 370327.178), (10, 622697.691), (20, 1198478.067)])
def test_capacity_of_one_block(snr_db, expected):
    assert capacity(180e3, db_to_linear(snr_db)).item() == pytest.approx(expected, abs=5e-4)


def test_power_control_reaches_its_target():
    loss = torch.tensor([60.0, 82.453555, 120.0])
    for target_db, lost in ((5.0, 0.632), (10.0, 0.271), (20.0, 0.031)):
        snr = mean_snr(loss, tx_power_for_target_dbm(loss, target_db, 180e3), 180e3)
        torch.testing.assert_close(snr, db_to_linear(target_db).expand(3))
        assert outage_probability(db_to_linear(5.0), snr)[0].item() == pytest.approx(lost, abs=5e-4)


def test_ergodic_efficiency_matches_scipy():
    snr = torch.logspace(-3, 5, 200, dtype=torch.float64)
    inverse = 1.0 / snr.numpy()
    large = inverse < 600  # beyond, scipy's E1 underflows
    expected = torch.from_numpy(exp1(inverse[large])) * torch.exp(1.0 / snr[large]) / math.log(2.0)
    torch.testing.assert_close(ergodic_efficiency(snr)[large], expected, rtol=1e-10, atol=0)


def test_ergodic_efficiency_is_the_mean_capacity():
    gain = rayleigh_power(3, torch.arange(1_000_000), torch.tensor(0), torch.tensor(0))
    rates = capacity(1.0, 10.0 * gain)
    error = rates.std() / math.sqrt(rates.numel())
    assert abs(rates.mean() - ergodic_efficiency(10.0)) < 3 * error


def test_resource_units():
    ten_db = torch.tensor([10.0])
    assert unit_bits(ten_db).item() == pytest.approx(622.697691, abs=5e-7)
    assert resource_units(torch.tensor([0, 1, 622, 623, 8192]), ten_db).tolist() == [0, 1, 1, 2, 14]
    assert resource_units(100, torch.zeros(1)).item() == 2**31 - 1
    assert [units_per_slot(t) for t in (0.02, 0.001, 0.0015)] == [2120, 106, 159]
    with pytest.raises(ValueError, match="no resource unit"):
        units_per_slot(1e-6)


@pytest.mark.parametrize("threshold, mean", [(-1.0, 10.0), (1.0, 0.0), (float("nan"), 1.0)])
def test_outage_rejects_decibels_given_by_mistake(threshold, mean):
    with pytest.raises(ValueError, match="linear"):
        outage_probability(threshold, mean)


def test_monte_carlo_outage_matches_the_closed_form():
    """1e6 draws, shared by a grid of distances, powers and thresholds; each within 3 standard errors."""
    draws = 1_000_000
    gain = rayleigh_power(11, torch.arange(draws), torch.tensor(0), torch.tensor(0)).sort().values
    checked = 0
    for distance in (10.0, 50.0, 150.0):
        loss = path_loss_db("DH", math.hypot(distance, 8.5), 3.75, False)
        for power_dbm in (-10.0, 0.0, 10.0, 23.0):
            snr = mean_snr(loss, power_dbm, TOTAL_BANDWIDTH_HZ)
            for threshold_db in (5.0, 10.0, 20.0):
                threshold = db_to_linear(threshold_db)
                expected = outage_probability(threshold, snr).item()
                realised = torch.searchsorted(gain, threshold / snr).item() / draws
                error = math.sqrt(expected * (1 - expected) / draws)
                assert abs(realised - expected) <= 3 * error + 1e-12
                checked += 1
    assert checked == 36
