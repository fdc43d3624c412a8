"""The bent regulator: its formula, its symmetry, its set-points and its limits."""

import pytest
import torch

from tsjepa.plants.bent_lqr import BentLQR
from tsjepa.plants.lqr import ClippedLQR

GAIN = [[-20.0, -100.0, -20.0, -30.0]]
DIRECTIONS = [[1.0, 2.0, 0.0, 0.5], [0.0, -3.0, 1.0, 0.0]]
HEIGHTS = [[4.0, -2.0]]
LAW = BentLQR(GAIN, 0.5, (-20.0,), (20.0,), DIRECTIONS, HEIGHTS)
STATE = torch.tensor([0.2, -0.03, 0.1, 0.05], dtype=torch.float64)


def test_the_command_is_the_regulators_and_the_terms():
    straight = ClippedLQR(torch.tensor(GAIN), 0.5, (-20.0,), (20.0,))
    first, second = 0.2 - 0.06 + 0.025, 0.09 + 0.1
    bend = 4 * torch.tanh(torch.tensor(first)) - 2 * torch.tanh(torch.tensor(second))
    assert LAW(STATE).item() == pytest.approx(straight(STATE).item() + bend.item(), rel=1e-6)
    none = BentLQR(GAIN, 0.5, (-20.0,), (20.0,), DIRECTIONS, [[0.0, 0.0]])
    torch.testing.assert_close(none(STATE), straight(STATE))


def test_it_is_odd_and_only_the_error_counts():
    torch.testing.assert_close(LAW(-STATE), -LAW(STATE))
    moved = STATE + torch.tensor([0.4, 0, 0, 0])
    torch.testing.assert_close(LAW(moved, torch.tensor([0.4], dtype=torch.float64)), LAW(STATE))


def test_it_stays_within_the_actuator_and_keeps_shape_and_dtype():
    assert LAW(torch.tensor([0.0, 0.5, 0.0, 0.0])).item() == 20.0
    many = torch.zeros(2, 3, 4, dtype=torch.float32)
    assert LAW(many, torch.zeros(2, 3, 1)).shape == (2, 3, 1) and LAW(many).dtype == torch.float32
