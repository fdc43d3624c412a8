"""Properties of the schedulers over 100,000 random cases, and their ages against theory."""

import pytest
import torch

from tsjepa.radio import SCHEDULERS, ChannelKnowledge, gated, grant
from tsjepa.radio.schedulers import channel_aware, channel_aware_literal, get_scheduler, max_age

CASES, DEVICES = 100_000, 8


def random_case(seed, cases=CASES, devices=DEVICES):
    generator = torch.Generator().manual_seed(seed)
    snr = torch.empty(cases, devices, dtype=torch.float64).exponential_(generator=generator)
    channel = ChannelKnowledge(
        snr=snr,
        success=torch.rand(cases, devices, generator=generator).double(),
        above_threshold=torch.rand(cases, devices, generator=generator) < 0.6,
        candidate=torch.rand(cases, devices, generator=generator) < 0.9,
    )
    # few distinct ages, so that ties are common
    age = torch.randint(1, 12, (cases, devices), generator=generator)
    demand = torch.randint(1, 5, (cases, devices), generator=generator)
    budget = torch.randint(0, 12, (cases,), generator=generator)
    memory = torch.randint(0, 4, (cases, devices), generator=generator).double()
    return age, channel, demand, budget, memory


def reference_grant(score, candidate, demand, budget):
    """The rule of ``grant``, one device at a time."""
    schedule = [False] * len(score)
    for i in sorted((i for i in range(len(score)) if candidate[i] and demand[i] <= budget), key=lambda i: -score[i]):
        if demand[i] > budget:
            break
        schedule[i] = True
        budget -= demand[i]
    return schedule


def test_grant_matches_a_plain_loop():
    age, channel, demand, budget, _ = random_case(0, cases=3000)
    expected = [
        reference_grant(*row)
        for row in zip(*(x.tolist() for x in (age, channel.candidate, demand, budget)), strict=True)
    ]
    assert grant(age, channel.candidate, demand, budget).tolist() == expected


@pytest.mark.parametrize("budget", [0, 1, 3, 8, 20])
def test_one_unit_each_is_the_same_by_threshold_and_by_sort(budget):
    age, channel, _, _, _ = random_case(1)
    fast = grant(age, channel.candidate, None, budget)
    slow = grant(age, channel.candidate, torch.ones_like(age), budget)
    assert torch.equal(fast, slow)
    assert torch.equal(fast.sum(-1), channel.candidate.sum(-1).clamp(max=budget))


def test_equal_scores_go_in_order_of_index():
    everyone = torch.ones(2, 6, dtype=torch.bool)
    score = torch.tensor([[1.0, 2, 2, 2, 2, 1], [5, 5, 5, 5, 5, 5]])
    assert grant(score, everyone, None, 3).int().tolist() == [[0, 1, 1, 1, 0, 0], [1, 1, 1, 0, 0, 0]]


def test_any_batch_shape():
    age = torch.randint(1, 9, (2, 3, 5))
    everyone = torch.ones(2, 3, 5, dtype=torch.bool)
    stacked = grant(age, everyone, None, 2)
    for i in range(2):
        for j in range(3):
            assert torch.equal(stacked[i, j], grant(age[i, j], everyone[i, j], None, 2))


@pytest.mark.parametrize("name", [name for name in SCHEDULERS if name != "oracle"])
def test_budget_and_candidates_are_respected(name):
    age, channel, demand, budget, memory = random_case(2)
    schedule, _ = SCHEDULERS[name](age, channel, demand, budget, memory)
    assert schedule.shape == age.shape and schedule.dtype == torch.bool
    assert ((demand * schedule).sum(-1) <= budget).all()
    assert not (schedule & ~channel.candidate).any()
    schedule, _ = SCHEDULERS[name](age, channel, None, 3, memory)
    assert (schedule.sum(-1) <= 3).all()
    assert not (schedule & ~channel.candidate).any()


@pytest.mark.parametrize("name", SCHEDULERS)
def test_gated_schedulers_never_pick_below_the_threshold(name):
    age, channel, demand, budget, memory = random_case(3)
    schedule, _ = gated(SCHEDULERS[name])(age, channel, demand, budget, memory)
    assert not (schedule & ~channel.above_threshold).any()


@pytest.mark.parametrize("scheduler", [channel_aware, channel_aware_literal])
def test_the_papers_scheduler_is_gated_by_itself(scheduler):
    age, channel, demand, budget, memory = random_case(4)
    schedule, _ = scheduler(age, channel, demand, budget, memory)
    assert not (schedule & ~channel.above_threshold).any()
    free, _ = scheduler(age, channel, None, DEVICES, memory, snr_gate=False)
    assert torch.equal(free, channel.candidate)


@pytest.mark.parametrize("aoi_reset", ["delivery", "scheduled"])
def test_equal_success_probabilities_make_channel_aware_max_age(aoi_reset):
    age, channel, demand, budget, memory = random_case(5)
    channel = channel._replace(
        success=channel.success[:, :1].expand(-1, DEVICES), above_threshold=torch.ones_like(channel.candidate)
    )
    for need, room in ((None, 3), (demand, budget)):
        ours, _ = channel_aware(age, channel, need, room, memory, aoi_reset=aoi_reset)
        assert torch.equal(ours, max_age(age, channel, need, room, memory)[0])


@pytest.mark.parametrize("aoi_reset", ["delivery", "scheduled"])
def test_equal_ages_make_channel_aware_highest_success_probability(aoi_reset):
    age, channel, demand, budget, memory = random_case(6)
    age = age[:, :1].expand(-1, DEVICES)
    channel = channel._replace(above_threshold=torch.ones_like(channel.candidate))
    for need, room in ((None, 3), (demand, budget)):
        ours, _ = channel_aware(age, channel, need, room, memory, aoi_reset=aoi_reset)
        assert torch.equal(ours, grant(channel.success, channel.candidate, need, room))


def test_channel_aware_maximises_the_papers_objective():
    """Against every subset of at most J devices, the age resetting on delivery."""
    age, channel, _, _, memory = random_case(7, cases=200)
    schedule, _ = channel_aware(age, channel, None, 3, memory, success_weight=0.7, age_weight=1.3)
    subsets = torch.cartesian_prod(*[torch.tensor([False, True])] * DEVICES)
    subsets = subsets[subsets.sum(-1) <= 3]

    def objective(picked, row):
        p = channel.success[row] * picked
        return (0.7 * p - 1.3 * (1 - p) * torch.log1p(age[row].double())).sum(-1)

    for row in range(200):
        allowed = channel.candidate[row] & channel.above_threshold[row]
        best = objective(subsets[~(subsets & ~allowed).any(-1)], row).max()
        assert objective(schedule[row], row) == pytest.approx(best.item(), abs=1e-9)


def test_round_robin_serves_in_a_cycle():
    channel = ChannelKnowledge(*[torch.ones(5)] * 2, *[torch.ones(5, dtype=torch.bool)] * 2)
    memory, picks = torch.zeros(5, dtype=torch.float64), []
    for _ in range(6):
        schedule, memory = SCHEDULERS["round_robin"](torch.ones(5), channel, None, 2, memory)
        picks.append(schedule.nonzero().flatten().tolist())
    assert picks == [[0, 1], [2, 3], [0, 4], [1, 2], [3, 4], [0, 1]]


def test_random_is_fair_and_repeats_for_a_seed():
    channel = ChannelKnowledge(*[torch.ones(1000, 6)] * 2, *[torch.ones(1000, 6, dtype=torch.bool)] * 2)
    memory = torch.zeros(1000, 6, dtype=torch.float64)
    first, memory = SCHEDULERS["random"](None, channel, None, 2, memory)
    second, _ = SCHEDULERS["random"](None, channel, None, 2, memory)
    assert first.double().mean(0).sub(1 / 3).abs().max() < 0.05
    assert not torch.equal(first, second)
    again, _ = SCHEDULERS["random"](None, channel, None, 2, torch.zeros_like(memory))
    assert torch.equal(first, again)


def test_proportional_fair_shares_time_between_unequal_links():
    snr = torch.tensor([100.0, 1.0])
    channel = ChannelKnowledge(snr, torch.ones(2), *[torch.ones(2, dtype=torch.bool)] * 2)
    memory, grants = torch.zeros(2, dtype=torch.float64), torch.zeros(2)
    for _ in range(2000):
        schedule, memory = SCHEDULERS["proportional_fair"](None, channel, None, 1, memory)
        grants += schedule
    assert grants[0].item() == pytest.approx(1000, abs=60)


def test_oracle_and_none():
    age, channel, demand, budget, memory = random_case(8, cases=10)
    assert torch.equal(SCHEDULERS["oracle"](age, channel, demand, budget, memory)[0], channel.candidate)
    assert not SCHEDULERS["none"](age, channel, demand, budget, memory)[0].any()


def test_bad_input_is_rejected():
    age, channel, demand, budget, memory = random_case(9, cases=1)
    with pytest.raises(ValueError, match="unknown scheduler 'fifo'"):
        get_scheduler("fifo")
    with pytest.raises(ValueError, match="aoi_reset"):
        channel_aware(age, channel, demand, budget, memory, aoi_reset="never")
