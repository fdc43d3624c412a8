"""The regulator against scipy's Riccati solver, and the law's clips, shapes and errors."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import torch

from tsjepa.plants import CartPole, DoubleCartPole
from tsjepa.plants.lqr import ClippedLQR, lqr_gain

GAIN = torch.tensor([[-20.0, -100.0, -20.0, -30.0]], dtype=torch.float64)
LAW = ClippedLQR(GAIN, 0.65, (-20.0,), (20.0,))


@pytest.mark.parametrize("slot", [0.001, 0.005, 0.02, 0.04])
@pytest.mark.parametrize("kind", [CartPole, DoubleCartPole])
def test_gain_agrees_with_scipy_and_stabilises(slot, kind):
    a, b = (m.numpy() for m in kind(slot).linear())
    weights = np.array([1.6, 1.0, 0.005, 0.005, 0.1, 0.1][: len(a)])
    cost = scipy.linalg.solve_discrete_are(a, b, np.diag(weights), [[1e-3]])
    expected = np.linalg.solve(1e-3 + b.T @ cost @ b, b.T @ cost @ a)
    gain = lqr_gain(torch.from_numpy(a), torch.from_numpy(b), weights, 1e-3).numpy()
    np.testing.assert_allclose(gain, expected, rtol=1e-5)
    assert np.abs(np.linalg.eigvals(a - b @ gain)).max() < 1


def test_two_commands_and_a_full_weight_matrix_agree_with_scipy():
    generator = np.random.default_rng(0)
    a, b, root = generator.normal(size=(4, 4)), generator.normal(size=(4, 2)), generator.normal(size=(4, 4))
    cost = scipy.linalg.solve_discrete_are(a, b, root @ root.T, np.diag([1.0, 3.0]))
    expected = np.linalg.solve(np.diag([1.0, 3.0]) + b.T @ cost @ b, b.T @ cost @ a)
    tensors = (torch.from_numpy(value) for value in (a, b, root @ root.T))
    np.testing.assert_allclose(lqr_gain(*tensors, (1.0, 3.0)).numpy(), expected, rtol=1e-8)


def test_moving_state_and_set_point_together_changes_nothing():
    state = torch.tensor([0.3, 0.02, -0.1, 0.05], dtype=torch.float64)
    moved = state + torch.tensor([0.4, 0, 0, 0])
    torch.testing.assert_close(LAW(moved, torch.tensor([0.4], dtype=torch.float64)), LAW(state))
    torch.testing.assert_close(LAW(-state), -LAW(state))


def test_saturates_force_and_position_error():
    assert LAW(torch.tensor([0.0, 0.5, 0.0, 0.0])).item() == 20.0
    assert LAW(torch.tensor([0.0, -0.5, 0.0, 0.0])).item() == -20.0
    far, near = torch.tensor([1.5, -0.2, 0.0, 0.0]), torch.tensor([0.65, -0.2, 0.0, 0.0])
    assert abs(LAW(near).item()) < 20
    torch.testing.assert_close(LAW(far), LAW(near))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("batch", [(), (0,), (5,), (2, 3)])
def test_keeps_batch_shape_and_dtype(batch, dtype):
    state = torch.zeros(*batch, 4, dtype=dtype)
    for reference in (None, torch.full((*batch, 1), 0.1)):
        force = LAW(state, reference)
        assert force.shape == (*batch, 1)
        assert force.dtype == dtype


def test_set_points_broadcast_against_one_state():
    force = LAW(torch.zeros(4), torch.tensor([[-0.1], [0.0], [0.1]]))
    torch.testing.assert_close(force, torch.tensor([[-2.0], [0.0], [2.0]]) * -1)


@pytest.mark.parametrize(
    ("state", "reference", "message"),
    [
        (torch.zeros(3), None, "last dimension must be 4"),
        (torch.zeros(()), None, "last dimension must be 4"),
        (torch.zeros(2, 4, dtype=torch.int64), None, "float32 or float64"),
        (torch.tensor([0.0, float("nan"), 0.0, 0.0]), None, "NaN"),
        (torch.zeros(4), torch.tensor([float("inf")]), "NaN or infinity"),
    ],
)
def test_rejects_bad_input(state, reference, message):
    with pytest.raises(ValueError, match=message):
        LAW(state, reference)
