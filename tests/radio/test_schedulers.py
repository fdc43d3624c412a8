"""Properties of the schedulers over 100,000 random cases, and their ages against theory."""

import pickle
from functools import partial

import pytest
import torch

from tsjepa.cli.errors import explain
from tsjepa.radio import SCHEDULERS, Known, gated, grant, periodic, simulate_ages
from tsjepa.radio.own_scheduler import checked
from tsjepa.radio.schedulers import (
    built_in_name,
    channel_aware,
    channel_aware_literal,
    get_scheduler,
    layers_of,
    max_age,
    name_of,
)

CASES, DEVICES = 100_000, 8
NEEDS = ("urgency", "expected_gain", "true_error", "age_cost")


def random_case(seed, cases=CASES, devices=DEVICES):
    generator = torch.Generator().manual_seed(seed)
    snr = torch.empty(cases, devices, dtype=torch.float64).exponential_(generator=generator)
    return Known(
        snr=snr,
        success=torch.rand(cases, devices, generator=generator).double(),
        above_threshold=torch.rand(cases, devices, generator=generator) < 0.6,
        candidate=torch.rand(cases, devices, generator=generator) < 0.9,
        # few distinct ages, so that ties are common
        age=torch.randint(1, 12, (cases, devices), generator=generator),
        demand=torch.randint(1, 5, (cases, devices), generator=generator),
        budget=torch.randint(0, 12, (cases,), generator=generator),
        memory=torch.randint(0, 4, (cases, devices), generator=generator).double(),
        slot=torch.randint(0, 6, (cases, devices), generator=generator),
        **{key: torch.rand(cases, devices, generator=generator) for key in NEEDS},
    )


def alike(*shape, **fields):
    """Devices that differ in nothing but ``fields``; one unit each."""
    ones, everyone = torch.ones(shape), torch.ones(shape, dtype=torch.bool)
    known = Known(ones, ones, ones, everyone, everyone, budget=1, memory=torch.zeros(shape, dtype=torch.float64))
    return known._replace(**fields)


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
    known = random_case(0, cases=3000)
    columns = (known.age, known.candidate, known.demand, known.budget)
    expected = [reference_grant(*row) for row in zip(*(x.tolist() for x in columns), strict=True)]
    assert grant(*columns).tolist() == expected


@pytest.mark.parametrize("budget", [0, 1, 3, 8, 20])
def test_one_unit_each_is_the_same_by_threshold_and_by_sort(budget):
    known = random_case(1)
    fast = grant(known.age, known.candidate, None, budget)
    slow = grant(known.age, known.candidate, torch.ones_like(known.age), budget)
    assert torch.equal(fast, slow)
    assert torch.equal(fast.sum(-1), known.candidate.sum(-1).clamp(max=budget))


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


@pytest.mark.parametrize("name", [name for name in SCHEDULERS if name not in ("once", "oracle")])
def test_budget_and_candidates_are_respected(name):
    known = random_case(2)
    schedule, _ = SCHEDULERS[name](known)
    assert schedule.shape == known.age.shape and schedule.dtype == torch.bool
    assert ((known.demand * schedule).sum(-1) <= known.budget).all()
    assert not (schedule & ~known.candidate).any()
    schedule, _ = SCHEDULERS[name](known._replace(demand=None, budget=3))
    assert (schedule.sum(-1) <= 3).all()
    assert not (schedule & ~known.candidate).any()


@pytest.mark.parametrize("name", SCHEDULERS)
def test_gated_schedulers_never_pick_below_the_threshold(name):
    known = random_case(3)
    schedule, _ = gated(SCHEDULERS[name])(known)
    assert not (schedule & ~known.above_threshold).any()


@pytest.mark.parametrize("scheduler", [channel_aware, channel_aware_literal])
def test_the_papers_scheduler_is_gated_by_itself(scheduler):
    known = random_case(4)
    schedule, _ = scheduler(known)
    assert not (schedule & ~known.above_threshold).any()
    free, _ = scheduler(known._replace(demand=None, budget=DEVICES), snr_gate=False)
    assert torch.equal(free, known.candidate)


@pytest.mark.parametrize("aoi_reset", ["delivery", "scheduled"])
def test_equal_success_probabilities_make_channel_aware_max_age(aoi_reset):
    known = random_case(5)
    known = known._replace(
        success=known.success[:, :1].expand(-1, DEVICES), above_threshold=torch.ones_like(known.candidate)
    )
    for case in (known, known._replace(demand=None, budget=3)):
        ours, _ = channel_aware(case, aoi_reset=aoi_reset)
        assert torch.equal(ours, max_age(case)[0])


@pytest.mark.parametrize("aoi_reset", ["delivery", "scheduled"])
def test_equal_ages_make_channel_aware_highest_success_probability(aoi_reset):
    known = random_case(6)
    known = known._replace(age=known.age[:, :1].expand(-1, DEVICES), above_threshold=torch.ones_like(known.candidate))
    for case in (known, known._replace(demand=None, budget=3)):
        ours, _ = channel_aware(case, aoi_reset=aoi_reset)
        assert torch.equal(ours, grant(case.success, case.candidate, case.demand, case.budget))


@pytest.mark.parametrize(
    ("age_growth", "cost"), [("logarithmic", torch.log), ("quadratic", torch.square)], ids=["the paper's", "quadratic"]
)
def test_channel_aware_maximises_its_objective(age_growth, cost):
    """Against every subset of at most J devices, the age resetting on delivery."""
    known = random_case(7, cases=200)._replace(demand=None, budget=3)
    schedule, _ = channel_aware(known, success_weight=0.7, age_weight=1.3, age_growth=age_growth)
    subsets = torch.cartesian_prod(*[torch.tensor([False, True])] * DEVICES)
    subsets = subsets[subsets.sum(-1) <= 3]

    def objective(picked, row):
        p = known.success[row] * picked
        grown = known.age[row].double() + 1
        return (0.7 * p - 1.3 * (p * cost(torch.ones_like(grown)) + (1 - p) * cost(grown))).sum(-1)

    for row in range(200):
        allowed = known.candidate[row] & known.above_threshold[row]
        best = objective(subsets[~(subsets & ~allowed).any(-1)], row).max()
        assert objective(schedule[row], row) == pytest.approx(best.item(), abs=1e-9)


def test_round_robin_serves_in_a_cycle():
    known, picks = alike(5, budget=2), []
    for _ in range(6):
        schedule, memory = SCHEDULERS["round_robin"](known)
        known = known._replace(memory=memory)
        picks.append(schedule.nonzero().flatten().tolist())
    assert picks == [[0, 1], [2, 3], [0, 4], [1, 2], [3, 4], [0, 1]]


def test_random_is_fair_and_repeats_for_a_seed():
    known = alike(1000, 6, budget=2)
    first, memory = SCHEDULERS["random"](known)
    second, _ = SCHEDULERS["random"](known._replace(memory=memory))
    assert first.double().mean(0).sub(1 / 3).abs().max() < 0.05
    assert not torch.equal(first, second)
    again, _ = SCHEDULERS["random"](known)
    assert torch.equal(first, again)


def test_proportional_fair_shares_time_between_unequal_links():
    known, grants = alike(2, snr=torch.tensor([100.0, 1.0])), torch.zeros(2)
    for _ in range(2000):
        schedule, memory = SCHEDULERS["proportional_fair"](known)
        known = known._replace(memory=memory)
        grants += schedule
    assert grants[0].item() == pytest.approx(1000, abs=60)


def test_oracle_and_none():
    known = random_case(8, cases=10)
    assert torch.equal(SCHEDULERS["oracle"](known)[0], known.candidate)
    assert not SCHEDULERS["none"](known)[0].any()


@pytest.mark.parametrize("period", [0, 1, 3])
def test_periodic_serves_every_period_whatever_the_channel_and_the_budget(period):
    known = random_case(10)._replace(budget=0)
    schedule, memory = periodic(period)(known)
    due = torch.isin(known.slot, torch.tensor({0: [0], 1: [0, 1, 2, 3, 4, 5], 3: [0, 3]}[period]))
    assert torch.equal(schedule, known.candidate & due)
    assert memory is known.memory


def test_once_is_the_first_slot_of_an_episode():
    known = random_case(11, cases=100)
    assert torch.equal(SCHEDULERS["once"](known)[0], periodic(0)(known)[0])


def test_periodic_in_the_pure_network_mode():
    trace = simulate_ages(periodic(4), num_devices=5, resource_blocks=1, slots=10, mean_snr_db=300.0, batch=2)
    assert trace.mean_age[:, 0].tolist() == [1, 2, 3, 4] * 2 + [1, 2]
    assert (trace.grants == 3).all() and (trace.deliveries == 3).all()
    assert (simulate_ages("once", 5, 1, 10).grants == 1).all()


def test_bad_input_is_rejected():
    known = random_case(9, cases=1)
    with pytest.raises(ValueError, match=r"unknown scheduler 'fifo' \(there are round_robin, "):
        get_scheduler("fifo")
    with pytest.raises(ValueError, match=r"'chanel_aware' - did you mean channel_aware\? \(there are") as refused:
        get_scheduler("chanel_aware")
    assert len(str(refused.value)) < 400
    with pytest.raises(ValueError, match="a function of one argument, known, not '--trust'"):
        get_scheduler("tsjepa.support.trust.TRUST")
    with pytest.raises(ValueError, match=r"scheduler os\.getcwd is not this package's own: add --trust"):
        get_scheduler("os.getcwd")
    with pytest.raises(
        ValueError, match=r"tsjepa\.radio\.gate cannot be imported: .* no 'gate' - did you mean gated\?"
    ):
        get_scheduler("tsjepa.radio.gate")
    with pytest.raises(ValueError, match=r"tsjepa\.absent\.mine cannot be imported: No module .* PYTHONPATH=\. before"):
        get_scheduler("tsjepa.absent.mine")
    with pytest.raises(ValueError, match="aoi_reset"):
        channel_aware(known, aoi_reset="never")
    with pytest.raises(ValueError, match="unknown age_growth"):
        channel_aware(known, age_growth="cubic")
    with pytest.raises(ValueError, match="period -1"):
        periodic(-1)
    with pytest.raises(ValueError, match="key 'slot'"):
        periodic(5)(known._replace(slot=None))


def test_a_scheduler_of_version_0_1_is_told_the_mend():
    with pytest.raises(ValueError, match="takes one argument, known"):
        get_scheduler(lambda age, channel, demand, budget, memory: (channel.candidate, memory))


def own(answer):
    """A scheduler of a user's that gives this for every slot."""

    def mine(known):
        return answer(known)

    return mine


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (lambda known: (known.candidate, known.memory), "mine granted up to 3 units beyond the budget"),
        (lambda known: known.candidate, r"returned \[1, 5\] of torch.bool: a pair of tensors is wanted"),
        (lambda known: (known.candidate, None), r"returned a tuple \(\[1, 5\] of torch.bool, a NoneType\): a pair"),
        (lambda known: (known.snr, known.memory), r"mine returned a schedule \[1, 5\] of torch.float32"),
        (lambda known: (known.candidate[:, :2], known.memory), r"mine returned a schedule \[1, 2\] of torch.bool"),
    ],
)
def test_an_answer_of_a_users_scheduler_that_cannot_be_is_refused_in_its_slot(answer, said):
    with pytest.raises(ValueError, match=said):
        simulate_ages(own(answer), num_devices=5, resource_blocks=2, slots=3)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (lambda known: {}["x"], r"raised KeyError: 'x' \(TSJEPA_TRACEBACK=1 shows where\)\.$"),
        (lambda known: known.snr * known.urgency, r"raised TypeError: .*; known.urgency is None here: give radio.requ"),
        (lambda known: 2 * known.true_error + known.urgency, "known.urgency is None here"),
        (lambda known: torch.exp(known.age_cost), "known.age_cost is None here: only the built-in schedulers"),
        (lambda known: known.agee, r"raised AttributeError: .* - did you mean age\?$"),
        (lambda known: known.deadline_of_each, "it has age, snr, success"),
        (lambda known: SCHEDULERS["genie"](known), "raised ValueError: this scheduler decides by known.true_error"),
        (lambda known: known.snr @ torch.ones(10_000, 3), "raised RuntimeError"),
    ],
)
def test_what_a_users_scheduler_raises_is_one_sentence_that_names_it(answer, said):
    with pytest.raises(ValueError, match=said) as refused:
        simulate_ages(own(answer), num_devices=5, resource_blocks=2, slots=3)
    assert str(refused.value).startswith(f"The scheduler {__name__}.mine raised ")
    assert len(str(refused.value)) < 400
    assert refused.value.__cause__.__traceback__ is not None
    assert explain(refused.value) == str(refused.value)


def test_the_memory_of_a_users_scheduler_is_float64_in_every_slot():
    known = alike(1, 3, budget=3)
    for memory in (known.age.to(torch.int64), known.memory.float() + 1):
        given = checked(own(lambda known, memory=memory: (known.candidate, memory)))(known)[1]
        assert given.dtype == torch.float64 and torch.equal(given, memory.double())


def test_a_scheduler_that_was_typed_into_an_interpreter_is_checked_too():
    names = {}
    exec("def mine(known):\n    return known.candidate, known.memory", {"__name__": None}, names)
    with pytest.raises(ValueError, match="beyond the budget"):
        simulate_ages(names["mine"], num_devices=5, resource_blocks=2, slots=3)


def test_units_beyond_the_budget_are_counted_where_devices_need_several():
    known = alike(1, 3, budget=5)._replace(demand=torch.tensor([[2, 2, 2]]))
    both = torch.tensor([[True, True, False]])
    assert checked(own(lambda known: (both, known.memory)))(known)[0] is both
    with pytest.raises(ValueError, match="1 units beyond the budget"):
        checked(own(lambda known: (torch.ones_like(both), known.memory)))(known)
    with pytest.raises(ValueError, match="no candidate"):
        absent = known._replace(candidate=torch.tensor([[True, False, True]]))
        checked(own(lambda known: (both, known.memory)))(absent)


def test_a_gate_takes_the_name_of_a_scheduler_too():
    known = random_case(13, cases=100)
    assert torch.equal(gated("max_age")(known)[0], gated(max_age)(known)[0])
    with pytest.raises(ValueError, match="unknown scheduler 'max_aeg' - did you mean max_age"):
        gated("max_aeg")


def test_what_ignores_the_budget_on_purpose_is_not_checked():
    for scheduler in (SCHEDULERS["oracle"], periodic(2), gated(SCHEDULERS["oracle"])):
        assert checked(scheduler) is scheduler


def test_a_checked_scheduler_can_be_sent_to_another_process():
    sent = pickle.loads(pickle.dumps(checked(partial(channel_aware, age_weight=2.0))))
    known = random_case(12, cases=100)
    assert torch.equal(sent(known)[0], channel_aware(known, age_weight=2.0)[0])


def test_names_of_functions_tell_their_arguments():
    assert name_of(periodic(5)) == "periodic(5)" and name_of("max_age") == "max_age"
    assert name_of(gated(SCHEDULERS["max_age"])) == name_of(gated("max_age")) == "gated(max_age)"
    assert name_of(partial(channel_aware, age_weight=2.0)) == "channel_aware(age_weight=2.0)"


@pytest.mark.parametrize("demand", [None, torch.ones(5, dtype=torch.int64)])
def test_a_score_that_is_not_a_number_is_never_granted(demand):
    everyone = torch.ones(5, dtype=torch.bool)
    score = torch.tensor([torch.nan, 0.0, torch.nan, 2.0, 1.0])
    assert grant(score, everyone, demand, 2).tolist() == [False, False, False, True, True]
    assert grant(score, everyone, demand, 4).tolist() == [False, True, False, True, True]
    assert grant(score, everyone, demand, 5).tolist() == [False, True, False, True, True]


def everybody(known):
    return known.candidate.clone(), known.memory


def test_what_is_put_around_a_scheduler_hides_neither_its_name_nor_its_budget():
    assert built_in_name(gated(partial(SCHEDULERS["channel_aware"], age_weight=2.0))) == "channel_aware"
    assert built_in_name("urgency") == "urgency" and built_in_name(gated(everybody)) is None
    assert layers_of(gated(everybody))[-1] is everybody and name_of(gated(everybody)) == "gated(everybody)"
    for scheduler in (everybody, gated(everybody)):
        with pytest.raises(ValueError, match=r"everybody\)? granted up to . units beyond the budget"):
            simulate_ages(scheduler, 10, 2, 50)
    assert checked(gated(max_age)).__name__ == "gated(max_age)"  # held to nothing more, as it is this package's own
