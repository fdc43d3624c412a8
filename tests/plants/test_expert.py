"""The expert against known gains, scipy's Riccati solver and a small simulation of the plant in MuJoCo."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.linalg
import torch
from tensordict.nn import TensorDictModule
from tsjepa.plants.expert import POLE_INERTIA, Expert, linearised_plant, lqr_gain, reference_lqr

import tsjepa  # noqa: F401  (chooses the GL backend before mujoco is imported)
from tsjepa.envs import FleetEnv

mujoco = pytest.importorskip("mujoco")
mujoco_rollout = pytest.importorskip("mujoco.rollout")

PLANT = """
<mujoco><option timestep="0.002" integrator="RK4"><flag contact="disable"/></option><worldbody>
  <body>
    <joint name="slide" type="slide" limited="true" axis="1 0 0" range="-1.8 1.8" solreflimit=".08 1" damping="5e-4"/>
    <geom type="box" size="0.2 0.15 0.1" mass="1"/>
    <body><joint type="hinge" axis="0 1 0" damping="2e-6"/>
      <geom type="capsule" fromto="0 0 0 0 0 1" size="0.045" mass=".1"/></body></body>
</worldbody><actuator><motor joint="slide" gear="1" ctrllimited="true" ctrlrange="-20 20"/></actuator></mujoco>
"""
HALF_WIDTHS = np.array([0.8, 0.3, 0.3, 0.3])
MEASUREMENT_NOISE = np.array([0.008, 0.005, 0.06, 0.08])
SCORE_FLOOR = 0.42


def draw_starts(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (count, 4)) * HALF_WIDTHS


def simulate(policy, starts, set_points=None, sampling_interval=0.02, noise=0.0, duration=2.0):
    """Run the policy from every start; returns score [N], quadratic cost [N], failed [N] and final state [N, 4]."""
    model = mujoco.MjModel.from_xml_string(PLANT)
    substeps = math.ceil(sampling_interval / 0.005)
    model.opt.timestep = sampling_interval / substeps
    slots = round(duration / sampling_interval)
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    full = np.concatenate([np.zeros((len(starts), 1)), starts], axis=1)
    score, cost, failed = np.zeros(len(starts)), np.zeros(len(starts)), np.zeros(len(starts), dtype=bool)
    for slot in range(slots):
        state = full[:, 1:5]
        target = np.zeros(len(starts)) if set_points is None else set_points[:, slot]
        observed = state + noise * MEASUREMENT_NOISE * generator.standard_normal(state.shape)
        force = policy(torch.from_numpy(observed), torch.from_numpy(target)).numpy()
        error = state - np.eye(4)[0] * target[:, None]
        score += (np.abs(error[:, :2]) <= 0.05).all(1) & ~failed
        cost += 0.5 * ((error**2).sum(1) + 1e-3 * force[:, 0] ** 2)
        held = np.repeat(force[:, None, :], substeps, axis=1)
        full = mujoco_rollout.rollout(model, data, full, held)[0][:, -1]
        failed |= (np.abs(full[:, 2]) > 0.8) | (np.abs(full[:, 1]) > 1.8)
    return score / slots, cost, failed, full[:, 1:5]


@pytest.fixture(scope="module")
def outcomes():
    starts = draw_starts(300, seed=0)
    return {name: simulate(policy, starts) for name, policy in (("expert", Expert()), ("reference", reference_lqr()))}


def test_reference_gain_has_the_recorded_digits():
    assert [round(k, 1) for k in reference_lqr(0.02).gain.tolist()] == [-73.6, -228.6, -57.7, -57.6]
    gentle = lqr_gain(0.02, (1.0, 1.0, 0.1, 0.1), 1e-3)
    assert [round(k, 1) for k in gentle.tolist()] == [-24.5, -121.1, -24.7, -32.2]


@pytest.mark.parametrize("sampling_interval", [0.001, 0.002, 0.005, 0.01, 0.02, 0.04])
def test_gain_agrees_with_scipy_and_stabilises(sampling_interval):
    a, b = (m.numpy() for m in linearised_plant(sampling_interval))
    weights = (1.6, 1.0, 0.005, 0.005)
    cost = scipy.linalg.solve_discrete_are(a, b, np.diag(weights), [[1e-3]])
    expected = np.linalg.solve(1e-3 + b.T @ cost @ b, b.T @ cost @ a)[0]
    gain = lqr_gain(sampling_interval, weights, 1e-3).numpy()
    np.testing.assert_allclose(gain, expected, rtol=1e-6)
    assert np.abs(np.linalg.eigvals(a - b @ gain[None])).max() < 1


def test_linearised_plant_agrees_with_mujoco():
    model = mujoco.MjModel.from_xml_string(PLANT)
    assert model.body_inertia[2, 0] == pytest.approx(POLE_INERTIA, rel=1e-6)
    a, b = (m.numpy() for m in linearised_plant(0.02))
    state, force = np.array([0.1, 1e-4, -2e-4, 3e-4]), 1e-3
    held = np.full((1, 10, 1), force)
    final = mujoco_rollout.rollout(model, mujoco.MjData(model), np.r_[0.0, state][None], held)[0][0, -1, 1:5]
    np.testing.assert_allclose(final, a @ state + b[:, 0] * force, atol=1e-9)


def test_expert_settles_every_start(outcomes):
    score, _, failed, final = outcomes["expert"]
    assert not failed.any()
    assert score.mean() >= SCORE_FLOOR
    assert (np.abs(final[:, :2]) <= 0.05).all(1).mean() > 0.95


def test_expert_is_not_worse_than_the_reference(outcomes):
    expert, reference = outcomes["expert"], outcomes["reference"]
    assert not reference[2].any()
    assert expert[0].mean() >= reference[0].mean()
    assert expert[1].mean() <= reference[1].mean()


def test_expert_passes_on_less_measurement_noise(outcomes):
    def command_noise(policy):
        return np.linalg.norm(policy.gain.numpy() * MEASUREMENT_NOISE)

    assert command_noise(Expert()) < 0.55 * command_noise(reference_lqr())
    score, _, failed, _ = simulate(Expert(), draw_starts(300, seed=0), noise=1.0)
    assert not failed.any()
    assert score.mean() > 0.9 * outcomes["expert"][0].mean()


@pytest.mark.parametrize("sampling_interval", [0.001, 0.002, 0.005, 0.01])
def test_no_start_fails_at_shorter_intervals(sampling_interval):
    score, _, failed, _ = simulate(Expert(sampling_interval), draw_starts(30, 3), sampling_interval=sampling_interval)
    assert not failed.any()
    assert score.mean() > 0.3


def test_tracks_changing_set_points():
    set_points = np.repeat(np.random.default_rng(4).uniform(-0.8, 0.8, (200, 4)), 25, axis=1)
    *_, failed, _ = simulate(Expert(), draw_starts(200, 5), set_points)
    assert not failed.any()


def test_settles_at_a_set_point():
    set_points = np.repeat(np.random.default_rng(6).uniform(-0.8, 0.8, (50, 1)), 200, axis=1)
    *_, failed, final = simulate(Expert(), draw_starts(50, 7), set_points, duration=4.0)
    assert not failed.any()
    np.testing.assert_allclose(final[:, 0], set_points[:, -1], atol=0.02)
    np.testing.assert_allclose(final[:, 1], 0, atol=0.02)


def test_moving_state_and_set_point_together_changes_nothing():
    state = torch.tensor([0.3, 0.02, -0.1, 0.05], dtype=torch.float64)
    moved = state + torch.tensor([0.4, 0, 0, 0])
    torch.testing.assert_close(Expert()(moved, 0.4), Expert()(state))
    torch.testing.assert_close(Expert()(-state), -Expert()(state))


def test_saturates_force_and_position_error():
    expert = Expert()
    assert expert(torch.tensor([0.0, 0.5, 0.0, 0.0])).item() == 20.0
    assert expert(torch.tensor([0.0, -0.5, 0.0, 0.0])).item() == -20.0
    far, near = torch.tensor([1.5, -0.2, 0.0, 0.0]), torch.tensor([0.65, -0.2, 0.0, 0.0])
    assert abs(expert(near).item()) < 20
    torch.testing.assert_close(expert(far), expert(near))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("batch", [(), (0,), (5,), (2, 3)])
def test_keeps_batch_shape_and_dtype(batch, dtype):
    state = torch.zeros(*batch, 4, dtype=dtype)
    for set_point in (0.1, torch.full(batch, 0.1)):
        force = Expert()(state, set_point)
        assert force.shape == (*batch, 1)
        assert force.dtype == dtype


def test_set_points_broadcast_against_one_state():
    force = Expert()(torch.zeros(4), torch.tensor([-0.1, 0.0, 0.1]))
    torch.testing.assert_close(force[:, 0], -Expert().gain[0].float() * torch.tensor([0.1, 0.0, -0.1]))


@pytest.mark.parametrize(
    ("state", "set_point", "message"),
    [
        (torch.zeros(3), 0.0, "last dimension must be 4"),
        (torch.zeros(()), 0.0, "last dimension must be 4"),
        (torch.zeros(2, 4, dtype=torch.int64), 0.0, "float32 or float64"),
        (torch.tensor([0.0, float("nan"), 0.0, 0.0]), 0.0, "NaN"),
        (torch.zeros(4), float("inf"), "NaN or infinity"),
    ],
)
def test_rejects_bad_input(state, set_point, message):
    with pytest.raises(ValueError, match=message):
        Expert()(state, set_point)


@pytest.mark.parametrize("sampling_interval", [0.0, -0.02, float("nan"), float("inf")])
def test_rejects_bad_sampling_interval(sampling_interval):
    with pytest.raises(ValueError, match="positive number of seconds"):
        Expert(sampling_interval)


def test_is_a_policy_for_environments():
    fleet = FleetEnv(4, frame_history=2, episode_length=100, seed=3, terminate_on_failure=False)
    policy = TensorDictModule(Expert(), in_keys=["state"], out_keys=["action"])
    rollout = fleet.rollout(100, policy)
    assert torch.equal(rollout["action"], Expert()(rollout["state"]))
    assert (rollout["next", "state"][:, -1, :2].abs() < 0.05).all()  # [devices, slots, 4]: all in the box at the end
