"""The plant's cost of age against hand-worked sums and Monte-Carlo, and what weights by it are worth."""

import math

import pytest
import torch

from tsjepa.radio import Known
from tsjepa.radio.cost import age_cost, age_cost_table, cost_weight, surviving_cost_table
from tsjepa.radio.schedulers import channel_aware, max_age, whittle

A = torch.tensor([[1.0, 0.1], [0.05, 1.1]], dtype=torch.float64)
P = torch.tensor([[3.0, 0.5], [0.5, 2.0]], dtype=torch.float64)
W = torch.tensor([[0.2, 0.1], [0.1, 0.4]], dtype=torch.float64)


def test_the_first_ages_by_hand():
    table = age_cost_table(A, P, W, 2)
    first = 3.0 * 0.2 + 2 * 0.5 * 0.1 + 2.0 * 0.4
    assert table[:2].tolist() == pytest.approx([0.0, first])
    later = A @ W @ A.mT
    assert table[2].item() == pytest.approx(first + torch.trace(P @ later).item())


def test_the_table_is_the_mean_cost_of_a_prediction():
    generator = torch.Generator().manual_seed(0)
    error, table = torch.zeros(200_000, 2, dtype=torch.float64), age_cost_table(A, P, W, 8)
    root = torch.linalg.cholesky(W)
    for age in range(1, 9):
        error = error @ A.mT + torch.randn(200_000, 2, generator=generator, dtype=torch.float64) @ root.mT
        cost = ((error @ P) * error).sum(-1)
        assert abs(cost.mean() - table[age]).item() < 4 * (cost.std() / 200_000**0.5).item()


def test_a_scalar_plant_has_the_geometric_series():
    table = age_cost_table(torch.tensor([[1.5]]), torch.tensor([[2.0]]), torch.tensor([[0.5]]), 10)
    expected = [2.0 * 0.5 * (1.5 ** (2 * h) - 1) / (1.5**2 - 1) for h in range(11)]
    assert table.tolist() == pytest.approx(expected)


def test_heterogeneous_plants_have_a_table_each():
    plants = torch.stack([A, 0.5 * A, 1.1 * A])
    table = age_cost_table(plants, P, W, 12)
    ages = torch.tensor([[1, 5, 12], [0, 3, 40]])
    found = age_cost(table, ages)
    for i in range(3):
        own = age_cost_table(plants[i], P, W, 12)
        assert torch.equal(found[:, i], age_cost(own, ages[:, i]))
    assert found[1, 2] == table[2, 12]


def never(error):
    return error[..., 0].abs() > math.inf


def test_of_plants_that_never_fall_the_drawn_table_is_the_sum():
    plants, draws = torch.stack([A, 0.5 * A]), 50_000
    drawn = surviving_cost_table(plants, P, W, torch.zeros(2, draws, 2), never, 8)
    # a squared Gaussian error has a standard deviation of at most sqrt(2) of its mean
    torch.testing.assert_close(drawn, age_cost_table(plants, P, W, 8), rtol=4 * math.sqrt(2 / draws), atol=0)


def test_a_start_that_is_not_known_grows_with_the_plant():
    start = torch.randn(50, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    table = surviving_cost_table(A, P, torch.zeros(2, 2), start, never, 3)
    for age in range(4):
        grown = start @ torch.linalg.matrix_power(A, age).mT
        torch.testing.assert_close(table[age], ((grown @ P) * grown).sum(-1).mean())


def test_whoever_has_fallen_costs_nothing():
    start, one = torch.tensor([[1.0], [0.5]], dtype=torch.float64), torch.ones(1, 1)
    table = surviving_cost_table(2.0 * one, one, 0.0 * one, start, lambda error: error[..., 0].abs() > 3, 4)
    # errors of 1, 2, 4 and of 0.5, 1, 2, 4
    assert table.tolist() == pytest.approx([(1 + 0.25) / 2, (4 + 1) / 2, 4 / 2, 0, 0])
    returning = surviving_cost_table(0.5 * one, one, 0.0 * one, 4.0 * start, lambda error: error[..., 0].abs() > 3, 2)
    assert returning.tolist() == pytest.approx([4 / 2, 1 / 2, 0.25 / 2])


def test_the_weight_of_a_linear_cost_is_its_slope():
    table = 3.0 * torch.arange(20, dtype=torch.float64)
    ages = torch.tensor([1, 4, 9])
    assert cost_weight(table, ages).tolist() == [3.0, 3.0, 3.0]
    own = 1 + torch.log1p(ages.double())
    torch.testing.assert_close(own * cost_weight(table, ages, growth="logarithmic"), 3.0 * ages.double())
    assert cost_weight(table, ages, demand=torch.tensor([1, 2, 3])).tolist() == [3.0, 1.5, 1.0]


def mean_cost(scheduler, growth=None, slots=600, devices=40, blocks=3):
    """Mean plant cost per device and slot of a fleet of which half the plants run away faster."""
    pace = torch.where(torch.arange(devices) % 2 == 0, 1.12, 1.0).double().view(-1, 1, 1)
    table = age_cost_table(pace, torch.ones(1, 1), torch.ones(1, 1), 60)
    generator = torch.Generator().manual_seed(0)
    age, everyone, total = torch.ones(devices), torch.ones(devices, dtype=torch.bool), 0.0
    memory = torch.zeros(devices, dtype=torch.float64)
    for _ in range(slots):
        open_ = torch.rand(devices, generator=generator) < 0.7
        weight = cost_weight(table, age, growth=growth) if growth else None
        known = Known(age, age, open_.double(), open_, everyone, blocks, memory, weight=weight)
        schedule, _ = scheduler(known)
        age = torch.where(schedule & open_, 1.0, age + 1)
        total += age_cost(table, age).mean().item() / slots
    return total


@pytest.mark.parametrize("scheduler, growth", [(channel_aware, "quadratic"), (whittle, "linear")])
def test_weights_by_the_plants_cost_beat_plain_age(scheduler, growth):
    weighed = mean_cost(scheduler, growth)
    assert weighed < 0.9 * mean_cost(scheduler)
    assert weighed < 0.8 * mean_cost(max_age)


def test_bad_input_is_rejected():
    with pytest.raises(ValueError, match="square and alike"):
        age_cost_table(A, P[:1, :1], W, 5)
    with pytest.raises(ValueError, match="unknown growth"):
        cost_weight(torch.ones(3), torch.ones(2), growth="cubic")
    with pytest.raises(ValueError, match="max_age 0"):
        age_cost_table(A, P, W, 0)
    with pytest.raises(ValueError, match="smaller max_age"):
        age_cost_table(1e3 * A, P, W, 100)
