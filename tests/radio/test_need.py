"""Schedulers by need against the best set there is, and by the plant's cost of age against the weights of a table."""

import itertools

import pytest
import torch

from tsjepa.radio import SCHEDULERS, Known, simulate_ages
from tsjepa.radio.cost import age_cost, age_cost_table, cost_weight
from tsjepa.radio.need import channel_aware_cost, expected_urgency, first_contact, genie, urgency, whittle_cost
from tsjepa.radio.schedulers import channel_aware, whittle

FIELDS = {urgency: "urgency", expected_urgency: "expected_gain", genie: "true_error"}


def fleet(devices=8, seed=0, **fields):
    generator = torch.Generator().manual_seed(seed)
    known = Known(
        age=torch.randint(1, 60, (devices,), generator=generator),
        snr=torch.ones(devices),
        success=torch.rand(devices, generator=generator).double(),
        above_threshold=torch.ones(devices, dtype=torch.bool),
        candidate=torch.ones(devices, dtype=torch.bool),
        budget=3,
        memory=torch.zeros(devices, dtype=torch.float64),
    )
    return known._replace(**fields)


@pytest.mark.parametrize("scheduler", FIELDS)
@pytest.mark.parametrize("seed", range(20))
def test_no_other_set_ends_more_need(scheduler, seed):
    need = torch.rand(8, generator=torch.Generator().manual_seed(100 + seed))
    known = fleet(seed=seed, weight=1 + torch.arange(8) % 2, **{FIELDS[scheduler]: need})
    gain = known.success * need * known.weight
    best = max(gain[list(chosen)].sum().item() for chosen in itertools.combinations(range(8), 3))
    assert gain[scheduler(known)[0]].sum().item() == pytest.approx(best)


@pytest.mark.parametrize("scheduler", FIELDS)
def test_a_need_counts_per_resource_unit(scheduler):
    need = torch.tensor([1.0, 1.0, 0.6])
    known = fleet(3, success=torch.ones(3), demand=torch.tensor([2, 1, 1]), budget=2, **{FIELDS[scheduler]: need})
    assert scheduler(known)[0].tolist() == [False, True, True]


def test_equal_needs_go_by_age_and_so_does_room_that_nobody_needs():
    known = fleet(success=torch.ones(8), urgency=torch.tensor([0.2, 0, 0, 0, 0.2, 0, 0, 0]))
    ages = known.age.tolist()
    oldest_of_the_rest = max((i for i in range(8) if i not in (0, 4)), key=lambda i: ages[i])
    assert urgency(known)[0].nonzero().flatten().tolist() == sorted([0, 4, oldest_of_the_rest])
    older = 0 if ages[0] > ages[4] else 4
    assert urgency(known._replace(budget=1))[0].nonzero().item() == older


def test_nobody_is_served_who_cannot_be_heard():
    known = fleet(success=torch.tensor([0, 0, 0, 0, 0, 0, 0, 0.5]), urgency=torch.ones(8))
    assert urgency(known)[0].nonzero().flatten().tolist() == [7]


@pytest.mark.parametrize("fields", [{}, {"weight": 1.0 + torch.arange(8) % 2}])
def test_first_contacts_go_before_everybody_and_the_others_as_channel_aware(fields):
    asked = torch.tensor([0, 0.09, 0, 0, 0.3, 0, 0.2, 0])
    known = fleet(success=torch.ones(8), urgency=asked, age=torch.tensor([9, 1, 9, 90, 1, 40, 2, 70]), **fields)
    order = [first_contact(known._replace(budget=budget))[0].nonzero().flatten().tolist() for budget in range(1, 6)]
    assert order == [[4], [4, 6], [1, 4, 6], [1, 3, 4, 6], [1, 3, 4, 6, 7]]
    nobody = known._replace(urgency=torch.zeros(8), success=fleet().success)
    assert torch.equal(first_contact(nobody)[0], channel_aware(nobody)[0])
    assert not torch.equal(first_contact(nobody)[0], first_contact(known)[0])


def test_first_contacts_count_per_resource_unit():
    known = fleet(3, success=torch.ones(3), demand=torch.tensor([2, 1, 1]), budget=2, urgency=torch.tensor([1, 1, 0.6]))
    assert first_contact(known)[0].tolist() == [False, True, True]


@pytest.mark.parametrize("in_units", [False, True])
def test_the_plants_cost_is_the_weight_of_the_table(in_units):
    pace = torch.where(torch.arange(40) % 2 == 0, 1.12, 1.0).double().view(-1, 1, 1)
    table = age_cost_table(pace, torch.ones(1, 1), torch.ones(1, 1), 60)
    demand = 1 + torch.arange(40) % 3 if in_units else None
    known = fleet(40, demand=demand, budget=6)
    known = known._replace(age_cost=age_cost(table, known.age))
    for ours, theirs, growth in ((channel_aware_cost, channel_aware, "logarithmic"), (whittle_cost, whittle, "linear")):
        weight = cost_weight(table, known.age, demand, growth)
        assert torch.equal(ours(known)[0], theirs(known._replace(weight=weight))[0])
        assert not torch.equal(ours(known)[0], theirs(known)[0])


@pytest.mark.parametrize(
    "name", ["urgency", "first_contact", "expected_urgency", "genie", "channel_aware_cost", "whittle_cost"]
)
def test_what_nobody_writes_is_named(name):
    with pytest.raises(ValueError, match="nothing writes here"):
        simulate_ages(SCHEDULERS[name], num_devices=4, resource_blocks=1, slots=2)
