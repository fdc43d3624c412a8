"""Positions, line of sight and shadowing."""

import math

import pytest
import torch

from tsjepa.radio import PAPER_LITERAL, Deployment, los_probability
from tsjepa.radio.deployment import distances_2d, large_scale

DEVICE = torch.arange(200_000)
EPISODE = torch.zeros_like(DEVICE)


def test_paper_literal_is_one_number():
    loss, los = large_scale(PAPER_LITERAL, 0, DEVICE[:7], EPISODE[:7])
    assert loss.tolist() == pytest.approx([82.453555] * 7, abs=5.1e-7)
    assert not los.any()


def test_positions_fill_the_hall_and_stay():
    distance = distances_2d(Deployment(), 0, DEVICE)
    assert distance.max() <= math.hypot(150, 75)
    # a disc of 50 m radius fits in the hall
    assert (distance < 50).double().mean().item() == pytest.approx(math.pi * 50**2 / (300 * 150), abs=0.004)
    assert torch.equal(distance, distances_2d(Deployment(), 0, DEVICE))


def test_los_and_shadowing_follow_their_laws():
    deployment = Deployment(scenario="SH", distance_2d_m=50.0)
    loss, los = large_scale(deployment, 0, DEVICE, EPISODE)
    probability = los_probability("SH", 50.0).item()
    assert los.double().mean().item() == pytest.approx(probability, abs=4 * math.sqrt(probability / DEVICE.numel()))
    assert loss[~los].std().item() == pytest.approx(5.9, rel=0.01)
    assert loss[~los].mean().item() == pytest.approx(83.099227, abs=0.05)
    again, _ = large_scale(deployment, 0, DEVICE, EPISODE + 1)
    assert not torch.equal(loss, again)


def test_unknown_rules_are_rejected():
    with pytest.raises(ValueError, match="LoS rule"):
        Deployment(los="maybe")
    with pytest.raises(ValueError, match="unknown scenario"):
        Deployment(scenario="XX")
