"""The cart-pole: what is changed against the suite's model, its equations, its experts and its score."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from drive import run
from tensordict.nn import TensorDictModule

from tsjepa.envs import FleetEnv, Radio
from tsjepa.evaluation.rollouts import Loop
from tsjepa.evaluation.rollouts import run as fleet_run
from tsjepa.plants import CartPole, build_plant, describe_plant
from tsjepa.plants.lqr import lqr_gain
from tsjepa.radio.schedulers import Known

MEASUREMENT_NOISE = np.array([0.008, 0.005, 0.06, 0.08])
POLE_INERTIA = 0.00942459  # kg m^2 about its centre: a solid capsule of 1 m between its caps' centres, radius 0.045 m


def analytic(slot: float) -> tuple[torch.Tensor, torch.Tensor]:
    """The equations of a cart (1 kg) and a pole (0.1 kg, 0.5 m to its centre) near the top, with the force held."""
    moment, damping = 0.1 * 0.5, torch.diag(torch.tensor([5e-4, 2e-6], dtype=torch.float64))
    mass = torch.tensor([[1.1, moment], [moment, POLE_INERTIA + moment * 0.5]], dtype=torch.float64)
    inverse = torch.linalg.inv(mass)
    continuous = torch.zeros(5, 5, dtype=torch.float64)
    continuous[:2, 2:4] = torch.eye(2)
    continuous[2:4, 1] = inverse[:, 1] * moment * 9.81
    continuous[2:4, 2:4] = -inverse @ damping
    continuous[2:4, 4] = inverse[:, 0]
    discrete = torch.linalg.matrix_exp(continuous * slot)
    return discrete[:4, :4], discrete[:4, 4:]


@pytest.mark.parametrize("slot", [0.001, 0.005, 0.02, 0.04])
def test_finite_differences_agree_with_the_equations_of_motion(slot):
    for ours, expected in zip(CartPole(slot).linear(), analytic(slot), strict=True):
        torch.testing.assert_close(ours, expected, atol=1e-7, rtol=0)
    assert CartPole(slot).model.body_inertia[2, 0] == pytest.approx(POLE_INERTIA, rel=1e-6)


def test_reference_gain_has_the_recorded_digits():
    gain = CartPole().experts()["reference LQR"].gain[0]
    assert [round(k, 1) for k in gain.tolist()] == [-73.6, -228.6, -57.7, -57.6]
    gentle = lqr_gain(*CartPole().linear(), (1.0, 1.0, 0.1, 0.1), 1e-3)[0]
    assert [round(k, 1) for k in gentle.tolist()] == [-24.5, -121.1, -24.7, -32.2]


@pytest.mark.slow
def test_expert_settles_every_start():
    score, failed, final = run(CartPole(), 100, count=100)
    assert failed == 0 and score >= 0.42
    assert (np.abs(final[:, :2]) <= 0.05).all(1).mean() > 0.95
    reference, reference_failed, _ = run(CartPole(), 100, count=100, expert="reference LQR")
    assert reference_failed == 0 and score >= reference


def test_expert_passes_on_less_measurement_noise_than_the_reference():
    experts = CartPole().experts()
    noise = {name: np.linalg.norm(law.gain.numpy() * MEASUREMENT_NOISE) for name, law in experts.items()}
    assert noise["expert"] < 0.55 * noise["reference LQR"]
    assert next(iter(experts)) == "expert" and CartPole().normaliser in experts


@pytest.mark.slow
def test_the_searched_law_scores_more_than_both_regulators_and_loses_nobody():
    for noise in (0.0, 0.008):
        plant = CartPole(process_noise_std=noise)
        score, failed, _ = run(plant, 100, count=100, expert="searched law")
        others = [run(plant, 100, count=100, expert=name)[0] for name in ("expert", "reference LQR")]
        assert failed == 0 and score > max(others) + 0.15


def test_the_searched_law_follows_the_wanted_position():
    plant = CartPole(set_point_step=0.3, set_point_slots=100)
    score, failed, final = run(plant, 99, count=50, expert="searched law")
    wanted = plant.references(1_000_000, np.arange(50), np.zeros(50, np.int64), np.full(50, 98))
    assert failed == 0 and score > 0.4
    np.testing.assert_allclose(final[:, :1], wanted, atol=0.03)


@pytest.mark.parametrize("other", [{"sampling_interval": 0.01}, {"pole_length": 0.5}])
def test_the_searched_laws_belong_to_the_machine_that_they_were_searched_on(other):
    assert list(CartPole(**other).experts()) == ["expert", "reference LQR"]
    assert list(CartPole().experts()) == ["expert", "reference LQR", "searched law", "fleet law"]
    with pytest.raises(ValueError, match="no expert 'fleet law': choose expert, reference LQR; "):
        CartPole(**other, expert="fleet law")


def test_the_chosen_expert_comes_first_and_drives():
    plant = CartPole(expert="fleet law")
    assert list(plant.experts()) == ["fleet law", "expert", "reference LQR", "searched law"]
    assert build_plant(describe_plant(plant)).expert == "fleet law"
    state = torch.tensor([[0.02, 0.01, 0.0, 0.0]])
    laws = [next(iter(each.experts().values()))(state) for each in (plant, CartPole())]
    assert torch.equal(laws[0], CartPole().experts()["fleet law"](state)) and not torch.equal(*laws)


def test_the_fleet_law_saves_machines_that_are_heard_of_late():
    def after_ten_slots(known: Known):
        return known.candidate & (known.slot >= 10), known.memory

    lost = {}
    for expert in ("expert", "fleet law"):
        radio = Radio(lossless=True, resource_blocks=80)
        loop = Loop(CartPole(expert=expert), scheduler=after_ten_slots, num_devices=80, radio=radio)
        lost[expert] = int(fleet_run(loop, seed=9).failed().sum())
    assert lost["fleet law"] <= 0.4 * lost["expert"] and lost["expert"] >= 8


@pytest.mark.parametrize("slot", [0.002, 0.005, 0.01])
def test_no_start_fails_at_shorter_intervals(slot):
    score, failed, _ = run(CartPole(slot), round(2.0 / slot), count=20)
    assert failed == 0 and score > 0.3


def test_follows_steps_of_the_wanted_position():
    plant = CartPole(set_point_step=0.5, set_point_slots=150)
    score, failed, final = run(plant, 149, count=50)
    wanted = plant.references(1_000_000, np.arange(50), np.zeros(50, np.int64), np.full(50, 148))
    assert failed == 0 and score > 0.35
    assert set(wanted[:, 0]) == {-0.5, 0.5}
    np.testing.assert_allclose(final[:, :1], wanted, atol=0.02)


def test_set_points_change_when_they_should_and_belong_to_the_device():
    plant = CartPole(set_point_step=0.5, set_point_slots=50)
    device, episode = np.arange(40), np.zeros(40, np.int64)
    at = [plant.references(0, device, episode, np.full(40, slot)) for slot in (0, 49, 50)]
    np.testing.assert_array_equal(at[0], at[1])
    assert 8 < (at[1] != at[2]).sum() < 32
    np.testing.assert_array_equal(plant.references(0, device[7:8], episode[7:8], np.array([50])), at[2][7:8])
    assert not CartPole().references(0, device, episode, episode).any()


def test_goals_are_held_and_within_their_range():
    goals = CartPole().goals(200, 100, torch.Generator().manual_seed(0))
    assert goals.shape == (200, 100, 1) and goals.abs().max() <= 0.8 and goals.abs().max() > 0.75
    assert (goals.diff(dim=1) != 0).sum(1).max() <= 3
    changes = (goals[:, 25] != goals[:, 24]).float().mean()
    assert 0.6 < changes < 0.8


def test_box_and_failure_limits():
    states = np.zeros((6, 4))
    states[:, :2] = [(0.05, -0.05), (0.051, 0.0), (0.0, 0.051), (-1.8, 0.8), (1.81, 0.0), (0.0, -0.81)]
    plant = CartPole()
    for given in (states, torch.from_numpy(states)):
        assert plant.score(given).tolist() == [True, False, False, False, False, False]
        assert plant.failed(given).tolist() == [False, False, False, False, True, True]
    moved = np.array([[0.54, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    assert plant.score(moved, np.full((2, 1), 0.5)).tolist() == [True, False]


def test_cost_is_quadratic():
    state, action = torch.tensor([0.3, 0.1, 0.2, 0.0]), torch.tensor([4.0])
    assert CartPole().cost(state, action).item() == pytest.approx(0.5 * (0.09 + 0.01 + 0.04 + 0.016))
    assert CartPole().cost(state, action, torch.tensor([0.3])).item() == pytest.approx(0.5 * (0.01 + 0.04 + 0.016))


@pytest.mark.parametrize("force", [20.001, -21.0, float("nan"), float("inf")])
def test_a_force_out_of_range_is_named(force):
    zero = np.zeros(2, np.int64)
    with pytest.raises(ValueError, match=str(force)):
        CartPole().advance(np.zeros((2, 4)), np.array([[0.0], [force]]), 0, zero, zero, zero)


def test_the_expert_is_a_policy_for_environments():
    plant = CartPole()
    fleet = FleetEnv(plant, 4, frame_history=2, episode_length=100, seed=3, terminate_on_failure=False)
    expert = plant.experts()["expert"]
    rollout = fleet.rollout(100, TensorDictModule(expert, in_keys=["state", "reference"], out_keys=["action"]))
    assert torch.equal(rollout["action"], expert(rollout["state"], rollout["reference"]))
    assert (rollout["next", "state"][:, -1, :2].abs() < 0.05).all()  # all in the box at the end
