"""Kinds of a plant behind one: every device is bit for bit what it is in a fleet of its own kind."""

import numpy as np
import pytest
import torch

from tsjepa.envs import FleetEnv, Radio, make_env
from tsjepa.evaluation.rollouts import Loop, every, perfect_feedback, run
from tsjepa.plants import CartPole, DoubleCartPole, Mixed, build_plant, describe_plant
from tsjepa.plants.lqr import lqr_value
from tsjepa.support.deal import deal

LENGTHS = (0.5, 1.0, 1.5)
KINDS = [CartPole(pole_length=length, process_noise_std=0.01 * length) for length in LENGTHS]
MIXED = Mixed(KINDS)
DEVICE, EPISODE = np.arange(7), np.zeros(7, np.int64)


def mass_and_moment(length):
    """Of a pole of 0.1 kg about its centre: a solid capsule of radius 0.045 m, by its cylinder and its two caps."""
    radius, cylinder = 0.045, np.pi * 0.045**2 * length
    caps = 4 / 3 * np.pi * radius**3
    tube, ball = 0.1 * cylinder / (cylinder + caps), 0.1 * caps / (cylinder + caps)
    offset = length / 2 + 3 / 8 * radius
    ends = ball * (0.4 * radius**2 - (3 / 8 * radius) ** 2 + offset**2)
    return tube * (length**2 / 12 + radius**2 / 4) + ends


@pytest.mark.parametrize("length", LENGTHS)
def test_the_pole_has_the_length_that_was_asked_for(length):
    model = CartPole(pole_length=length).model
    assert model.body_mass[2] == pytest.approx(0.1)
    assert model.body_ipos[2].tolist() == pytest.approx([0, 0, length / 2])
    assert model.body_inertia[2, 0] == pytest.approx(mass_and_moment(length), rel=1e-6)


def test_a_shorter_pole_falls_faster():
    growth = [torch.linalg.eigvals(a).abs().max() for a in MIXED.linear()[0]]
    assert growth[0] > growth[1] > growth[2] > 1


@pytest.mark.parametrize("kind", range(3))
def test_each_device_is_what_it_is_among_its_own_kind(kind):
    mixed, alone = (
        run(perfect_feedback(Loop(plant, num_devices=7, slots=30), "expert"), 3) for plant in (MIXED, KINDS[kind])
    )
    for name in ("state", "action", "expert_action", "score", "failed_now"):
        assert torch.equal(getattr(mixed, name)[:, kind::3], getattr(alone, name)[:, kind::3]), name
    assert not torch.equal(mixed.state, alone.state)


def test_prediction_knows_each_kind():
    """Without noise an expert that hears once from near the goal goes on as if it heard always."""
    quiet = Mixed([CartPole(pole_length=length, start_half_widths=(0.05,) * 4) for length in LENGTHS])
    loop = Loop(quiet, "linear", num_devices=5, slots=40)
    told, once = run(perfect_feedback(loop, "expert"), 0), run(every(loop, 0), 0)
    torch.testing.assert_close(once.state, told.state, atol=0.01, rtol=0)
    wrong = run(every(Loop(quiet.plants[0], "linear", num_devices=5, slots=40), 0), 0)
    assert not torch.allclose(wrong.state[:, 1::3], told.state[:, 1::3], atol=0.01)


def test_pictures_show_the_kind():
    physics = MIXED.start(0, DEVICE, EPISODE)
    pictures = MIXED.render(MIXED.scene(physics, 0, DEVICE, EPISODE))
    for kind, plant in enumerate(KINDS):
        own = physics[kind::3, :-1]
        scenes = plant.scene(own, 0, DEVICE[kind::3], EPISODE[kind::3])
        assert np.array_equal(pictures[kind::3], plant.render(scenes))


def test_the_price_of_an_error_solves_riccatis_equation():
    (q, r), (a, b) = ((1.6, 1.0, 0.005, 0.005), 1e-3), CartPole().linear()
    p, w = CartPole(process_noise_std=[0.1, 0.2]).error_cost()
    gain = torch.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
    torch.testing.assert_close(p, torch.diag(torch.tensor(q).double()) + a.T @ p @ (a - b @ gain), rtol=1e-9, atol=1e-9)
    assert torch.equal(p, lqr_value(a, b, q, r)) and w.diagonal().tolist() == pytest.approx([0, 0, 0.01, 0.04])
    assert MIXED.error_cost()[0].shape == (3, 4, 4)


def test_it_comes_back_from_plain_values():
    again = build_plant(describe_plant(MIXED))
    assert [plant.pole_length for plant in again.plants] == list(LENGTHS)
    physics = MIXED.start(1, DEVICE, EPISODE)
    assert np.array_equal(again.start(1, DEVICE, EPISODE), physics)


def test_a_list_is_dealt_out_in_turn():
    assert deal([1.0, 2.0, 3.0], 5).tolist() == [1, 2, 3, 1, 2] and deal(4.0, 2).tolist() == [4, 4]
    with pytest.raises(ValueError, match="empty"):
        deal([], 3)


def test_what_cannot_be_mixed_is_refused():
    with pytest.raises(ValueError, match="at least 2 kinds"):
        Mixed([CartPole()])
    for other in (DoubleCartPole(), CartPole(sampling_interval=0.01)):
        with pytest.raises(ValueError, match="not like CartPole"):
            Mixed([CartPole(), other])
    with pytest.raises(ValueError, match="pole_length 0"):
        CartPole(pole_length=0)
    with pytest.raises(ValueError, match="batch of fleets"):
        FleetEnv(MIXED, 6, batch_size=[2, 6])
    with pytest.raises(ValueError, match="predicted exactly"):
        make_env(MIXED, 3, "round_robin", Radio(), "exact")
