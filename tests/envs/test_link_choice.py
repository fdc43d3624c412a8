"""Interference, one repetition, block errors and joules in the chain, against closed forms."""

import math

import pytest
import torch
from linear_fleet import LinearFleet
from torchrl.envs import Compose, TransformedEnv

from tsjepa.envs.transforms import Channel, Codec, Energy, Scheduler, Uplink
from tsjepa.radio import outage_probability
from tsjepa.radio.codecs import FloatCodec
from tsjepa.radio.decoding import Decoding
from tsjepa.radio.energy import EnergyModel
from tsjepa.radio.harq import residual_outage
from tsjepa.radio.link import BLOCK_BANDWIDTH_HZ, tx_power_for_target_dbm
from tsjepa.radio.links import AdaptedDecoding, McsLink
from tsjepa.radio.mcs import block_error_rate

THRESHOLD, MEAN = 10**0.5, 10**0.8


def repeating():
    return Channel(snr_target_db=8.0, repetition_s=0.008)


def rollout(*transforms, slots=60, devices=100):
    env = TransformedEnv(LinearFleet((devices,)), Compose(*transforms))
    still = torch.zeros(devices, 1)
    return env.rollout(slots, lambda td: td.set("action", still), break_when_any_done=False)


def share(flags):
    return flags.double().mean().item()


def standard_errors(expected, flags):
    return 3.5 * math.sqrt(expected * (1 - expected) / flags.numel())


def test_interference_as_strong_as_the_noise_halves_the_sinr():
    free = rollout(Channel(), slots=5)
    lifted = rollout(Channel(interference_rise_db=10 * math.log10(2)), slots=5)
    for key in ("snr", "mean_snr"):
        torch.testing.assert_close(lifted[key], free[key] / 2)


def test_one_repetition_leaves_the_residual_outage_of_independent_fading():
    data = rollout(repeating(), Uplink(in_key=None, repeats=True))
    expected = residual_outage(THRESHOLD, MEAN, MEAN).item()
    assert share(~data["delivered"]) == pytest.approx(expected, abs=standard_errors(expected, data["delivered"]))
    first = outage_probability(THRESHOLD, MEAN).item()
    repeated = data["transmissions"] == 2
    assert share(repeated) == pytest.approx(first, abs=standard_errors(first, repeated))
    assert torch.equal(repeated, data["snr"] < THRESHOLD)


def test_a_repetition_in_correlated_fading_helps_less():
    channel = Channel(snr_target_db=8.0, max_doppler_hz=10.4239, repetition_s=0.008)
    data = rollout(channel, Uplink(in_key=None, repeats=True))
    lost = share(~data["delivered"])
    both = Decoding((THRESHOLD,), repetition=0.932)
    assert lost == pytest.approx(1 - both.given_mean(torch.tensor([MEAN])).item(), abs=0.03)
    assert lost > 1.2 * residual_outage(THRESHOLD, MEAN, MEAN).item()


def test_success_is_predicted_with_the_repetition():
    """What is scheduled by perfect knowledge below the threshold still arrives by its repetition now and then."""
    belief = Decoding((THRESHOLD,), repetition=0.0)
    data = rollout(
        repeating(), Scheduler("channel_aware", 80, decoding=belief), Uplink(in_key=None, repeats=True), slots=100
    )
    hopeless = data["scheduled"] & (data["snr"] < THRESHOLD)
    assert hopeless.sum() > 300
    predicted = belief.given_snr(data["snr"], data["mean_snr"])[hopeless]
    tolerance = 3.5 * (predicted * (1 - predicted)).sum().sqrt()
    assert abs(predicted.sum() - data["delivered"][hopeless].sum()) <= tolerance


def test_block_errors_have_the_rate_of_their_curve():
    """64 bits at an SNR where a third of the blocks fail, without fading."""
    grid = torch.linspace(0.1, 20, 20_000, dtype=torch.float64)
    snr_db = 10 * math.log10(grid[(block_error_rate(7, grid, 64) - 1 / 3).abs().argmin()].item())
    chain = [Channel(snr_target_db=snr_db, fading="none"), Codec(FloatCodec(), in_key="state"), Uplink(mcs=McsLink(7))]
    data = rollout(*chain)
    assert (data["payload_bits"] == 64).all()
    assert share(~data["delivered"]) == pytest.approx(1 / 3, abs=standard_errors(1 / 3, data["delivered"]))


def test_an_mcs_that_follows_the_snr_meets_its_target_with_the_units_of_its_table():
    link, chain = McsLink(None), [Channel(snr_target_db=15.0)]
    chain += [
        Scheduler("max_age", payload_bits=64, units=40, decoding=AdaptedDecoding(link, 64), demand=link.units),
        Codec(FloatCodec(), in_key="state"),
        Uplink(mcs=link, demand=link.units),
    ]
    data = rollout(*chain)
    sent = data["scheduled"] & (data["snr"] >= THRESHOLD)
    assert torch.equal(data["resource_units"][sent], link.units(64, data["snr"][sent].double()))
    errors = link.error_rate(64, data["snr"][sent].double())
    assert errors.max() <= 0.1
    spread = (errors * (1 - errors)).sum().sqrt()
    assert abs(errors.sum() - (~data["delivered"][sent]).sum()) <= 3.5 * spread + 1


def test_joules_by_hand():
    """200 mW (23 dBm) at an efficiency of a half for 3 ms, 10 mW of circuit, 2 mJ of encoder."""
    model = EnergyModel(encode_j=2e-3, circuit_w=0.01, amplifier_efficiency=0.5, airtime_s=3e-3)
    data = rollout(Scheduler("round_robin", 25), Energy(model), slots=4)
    joules = 2e-3 + 3e-3 * (0.199526 / 0.5 + 0.01)
    sent = data["scheduled"]
    torch.testing.assert_close(data["energy_j"][sent], torch.full((100,), joules), atol=1e-7, rtol=0)
    assert (data["energy_j"][~sent] == 0).all()


def test_power_control_and_repetitions_are_counted():
    data = rollout(repeating(), Uplink(in_key=None, repeats=True), Energy(EnergyModel(), snr_target_db=8.0), slots=4)
    watts = 10 ** (tx_power_for_target_dbm(data["path_loss_db"], 8.0, BLOCK_BANDWIDTH_HZ) / 10 - 3)
    expected = 1e-3 * watts * data["transmissions"]
    torch.testing.assert_close(data["energy_j"].double(), expected, atol=0, rtol=1e-6)


def test_granted_units_are_milliseconds():
    chain = [Channel(), Scheduler("max_age", payload_bits=640, units=50), Energy(EnergyModel(), tx_power_dbm=30.0)]
    data = rollout(*chain, slots=4)
    torch.testing.assert_close(data["energy_j"].double(), data["resource_units"].double() * 1e-3, atol=0, rtol=1e-6)
    assert data["resource_units"].max() > 0
