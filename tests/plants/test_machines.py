"""Double cart-pole, pendulum and reacher: what their experts score, what a held command costs, and their states."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from drive import run

from tsjepa.plants import DoubleCartPole, Pendulum, Reacher
from tsjepa.plants.mujoco_plant import MujocoPlant
from tsjepa.plants.reacher import finger

ONE = np.ones(1, np.int64)


@pytest.mark.parametrize(("expert", "low", "high"), [("expert", 0.58, 0.67), ("reference LQR", 0.60, 0.69)])
def test_no_double_cart_pole_falls(expert, low, high):
    score, failed, final = run(DoubleCartPole(), 100, count=100, expert=expert)
    assert failed == 0 and low < score < high
    assert DoubleCartPole().score(final).mean() > 0.9


@pytest.mark.slow
def test_a_held_command_loses_the_double_cart_pole():
    score, failed, _ = run(DoubleCartPole(), 100, count=100, hold=10)
    assert failed > 90 and score < 0.15
    assert run(DoubleCartPole(), 100, count=100, hold=2)[1] == 0


def test_the_double_cart_poles_gain_and_unstable_modes_are_those_recorded():
    plant = DoubleCartPole()
    gain = plant.experts()["reference LQR"].gain[0]
    assert [round(value) for value in gain.tolist()] == [21, 217, 420, 32, 113, 88]
    modes = torch.linalg.eigvals(plant.linear()[0]).abs().sort().values
    torch.testing.assert_close(modes[-2:], torch.tensor([1.058, 1.150], dtype=torch.float64), atol=1e-3, rtol=0)


def test_the_double_cart_pole_scores_absolute_angles():
    states = np.zeros((6, 6))
    states[:, :3] = [(0.2, 0.1, -0.2), (0.21, 0, 0), (0, 0.09, 0.02), (0, 0.7, 0.2), (0, 0.7, -0.2), (1.81, 0, 0)]
    plant = DoubleCartPole()
    for given in (states, torch.from_numpy(states)):
        assert plant.score(given).tolist() == [True, False, False, False, False, False]
        assert plant.failed(given).tolist() == [False, False, False, True, False, True]


def test_the_double_cart_pole_follows_steps_of_the_wanted_position():
    plant = DoubleCartPole(set_point_step=0.3, set_point_slots=150)
    _, failed, final = run(plant, 149, count=40)
    assert failed == 0
    np.testing.assert_allclose(np.abs(final[:, 0]), 0.3, atol=0.1)


@pytest.mark.slow
def test_the_pendulum_comes_up_from_everywhere():
    score, failed, final = run(Pendulum(), 500, count=100)
    assert failed == 0 and 0.6 < score < 0.72
    assert Pendulum().score(final).mean() > 0.97
    held, *_ = run(Pendulum(), 500, count=100, hold=20)
    assert held < 0.2


def test_a_hanging_pendulum_is_not_up_after_two_seconds():
    plant = Pendulum(start_half_widths=(0.0, 0.0))
    plant.start = lambda seed, device, episode: np.tile([math.pi, 0.0], (len(device), 1))
    score, _, final = run(plant, 100, count=1)
    assert score == 0 and final[0, 0] < 0.99


def test_the_pendulums_gain_is_the_recorded_one():
    gain = Pendulum().experts()["expert"].gain
    torch.testing.assert_close(gain, torch.tensor([[10.2, 2.29]], dtype=torch.float64), atol=5e-3, rtol=0)


def test_pumping_adds_energy_until_there_is_enough():
    law = Pendulum().experts()["expert"]
    below, above = torch.tensor([-1.0, 0.0, 3.0]), torch.tensor([-1.0, 0.0, 12.0])
    assert law(below).item() == 1.0 and law(below * torch.tensor([1.0, 1.0, -1.0])).item() == -1.0
    assert law(above).item() == -1.0
    assert abs(law(torch.tensor([-1.0, 0.0, 0.0])).item()) == 1.0  # hanging still is not a place to stay


def test_the_pendulums_angle_wraps_and_its_box_is_eight_degrees():
    plant = Pendulum()
    states = plant.state(np.array([[math.radians(7.9), 0.0], [2 * math.pi, 1.0], [math.radians(8.1), 0.0], [3.0, 0.0]]))
    assert plant.score(states).tolist() == [True, True, False, False]
    assert not plant.failed(states).any() and plant.linear() is None


def test_the_reachers_finger_is_where_mujoco_has_it():
    import mujoco

    plant, data = Reacher(), mujoco.MjData(Reacher().model)
    for position in np.random.default_rng(0).uniform(-2.5, 2.5, (10, 2)):
        data.qpos[:] = position
        mujoco.mj_kinematics(plant.model, data)
        state = plant.state(np.concatenate([position, [0.0, 0.0]])[None])
        for given in (state, torch.from_numpy(state)):
            found = np.stack([np.asarray(value) for value in finger(given)], axis=-1)[0]
            np.testing.assert_allclose(found, data.geom("finger").xpos[:2], atol=1e-12)


@pytest.mark.parametrize(
    ("goal_slots", "slots", "hold", "low", "high"),
    [(0, 150, 1, 0.83, 0.91), (50, 200, 1, 0.58, 0.70), (0, 150, 5, 0.44, 0.55), (0, 150, 20, 0.0, 0.08)],
)
def test_what_the_reachers_expert_scores(goal_slots, slots, hold, low, high):
    score, failed, _ = run(Reacher(goal_slots=goal_slots), slots, count=100, hold=hold)
    assert failed == 0 and low < score < high


def test_the_reacher_keeps_to_the_side_of_its_wrist():
    law, goal = Reacher().experts()["expert"], torch.tensor([[0.1, 0.1]])
    states = torch.tensor([[1.0, 0.0, wrist, 0.0, 0.0] for wrist in (0.05, -0.05)])
    commands = law(states, goal)
    assert commands[0, 1] > 0 > commands[1, 1]
    # both postures rest at the goal
    for sign in (1.0, -1.0):
        wrist = sign * math.acos((0.02) / (2 * 0.12**2) - 1)
        shoulder = math.pi / 4 - wrist / 2
        rest = torch.tensor([math.cos(shoulder), math.sin(shoulder), wrist, 0.0, 0.0])
        torch.testing.assert_close(law(rest, goal[0]), torch.zeros(2), atol=1e-5, rtol=0)
        assert Reacher().score(rest, goal[0])


def test_goals_lie_in_the_suites_ring_and_change_when_they_should():
    plant, devices = Reacher(goal_slots=50), np.arange(2000)
    zeros = np.zeros(2000, np.int64)
    first, later, next_goal = (plant.references(3, devices, zeros, zeros + slot) for slot in (0, 49, 50))
    np.testing.assert_array_equal(first, later)
    assert (first != next_goal).all()
    radius = np.linalg.norm(first, axis=1)
    assert radius.min() >= 0.05 and radius.max() <= 0.20
    assert abs(radius.mean() - 0.125) < 0.003 and np.abs(first.mean(0)).max() < 0.008
    np.testing.assert_array_equal(plant.references(3, devices[9:10], ONE * 0, ONE * 50), next_goal[9:10])
    still = Reacher(goal_slots=0)
    np.testing.assert_array_equal(
        still.references(3, devices, zeros, zeros + 700), still.references(3, devices, zeros, zeros)
    )


def test_goals_for_data_are_of_the_same_kind():
    goals = Reacher(goal_slots=40).goals(500, 100, torch.Generator().manual_seed(0))
    assert goals.shape == (500, 100, 2)
    radius = goals.norm(dim=-1)
    assert radius.min() >= 0.05 - 1e-6 and radius.max() <= 0.20 + 1e-6
    changes = (goals.diff(dim=1) != 0).any(-1)
    assert changes.sum(1).tolist() == [2] * 500 and changes[:, [39, 79]].all()
    assert Reacher(goal_slots=0).goals(3, 100, torch.Generator()).diff(dim=1).abs().max() == 0


def test_what_a_picture_shows_of_the_reacher_does_not_depend_on_the_goal():
    plant = Reacher()
    assert plant.scene(np.zeros((1, 4)), 0, ONE, ONE).shape == (1, 2 + 3 * 3)
    assert "target" not in [plant.model.geom(index).name for index in range(plant.model.ngeom)]
    assert isinstance(plant, MujocoPlant) and plant.linear() is None
