"""Mean ages: the printed reference numbers, and the pure network mode against theory."""

import math
from functools import partial

import pytest
import torch

from tsjepa.radio import (
    SCHEDULERS,
    mean_age_lower_bound,
    mean_age_opportunistic,
    mean_age_random,
    mean_age_round_robin,
    simulate_ages,
    whittle_index,
)
from tsjepa.radio.age import next_age
from tsjepa.radio.need import __name__ as by_need

WITHOUT_A_PLANT = [name for name, decide in SCHEDULERS.items() if decide.__module__ != by_need]

SYSTEMS = [(10, 2, 0.573292), (20, 5, 0.8), (30, 3, 0.35)]


def mean_snr_db_for(success, threshold_db=5.0):
    """The mean SNR at which a Rayleigh link succeeds with the given probability."""
    return threshold_db - 10 * math.log10(-math.log(success))


def simulated_age(scheduler, num_devices, resource_blocks, success, slots=1200, batch=200, **options):
    trace = simulate_ages(
        scheduler,
        num_devices,
        resource_blocks,
        slots,
        mean_snr_db=mean_snr_db_for(success),
        batch=batch,
        **options,
    )
    return trace.mean_age[slots // 4 :].mean().item()


def test_reference_numbers():
    assert mean_age_round_robin(10, 2, 0.573292) == pytest.approx(6.721559, abs=5.1e-7)
    assert mean_age_random(10, 2, 0.573292) == pytest.approx(8.721559, abs=5.1e-7)
    assert mean_age_opportunistic(10, 2, 0.573292) == pytest.approx(5.007735, abs=5.1e-7)
    assert mean_age_lower_bound(10, 2, 0.573292) == pytest.approx(3.003867, abs=6e-7)
    index = whittle_index(torch.tensor(7), torch.tensor(0.4, dtype=torch.float64), weight=2.0)
    assert index.item() == pytest.approx(2.0 * 0.4 * 7 / 2 * (7 + 1.6 / 0.4))


def test_next_age():
    assert next_age(torch.tensor([1, 5, 9]), torch.tensor([True, False, True])).tolist() == [1, 6, 1]


@pytest.mark.parametrize("system", SYSTEMS)
def test_simulated_ages_match_theory(system):
    theory = {
        "random": mean_age_random(*system),
        "opportunistic": mean_age_opportunistic(*system),
        "round_robin": mean_age_round_robin(*system),
    }
    for scheduler, expected in theory.items():
        assert simulated_age(scheduler, *system) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("system", SYSTEMS)
def test_channel_aware_lies_between_the_bound_and_opportunistic(system):
    age = simulated_age("channel_aware", *system)
    assert mean_age_lower_bound(*system) < age < 0.9 * mean_age_opportunistic(*system)


@pytest.mark.slow
def test_the_printed_sign_behind_the_gate_is_ten_times_older():
    system = SYSTEMS[0]
    literal = simulated_age("channel_aware_literal", *system, slots=16_000, batch=12)
    ours = simulated_age("channel_aware", *system)
    assert 55 < literal < 87
    assert literal > 10 * ours


def test_the_printed_sign_without_the_gate_grows_linearly():
    """J devices stay fresh, and the others are never served again."""

    ungated = partial(SCHEDULERS["channel_aware_literal"], snr_gate=False)
    trace = simulate_ages(ungated, 10, 2, 4000, csi="statistical", mean_snr_db=mean_snr_db_for(0.99), batch=8)
    growth = (trace.mean_age[3999] - trace.mean_age[1999]) / 2000
    assert growth.mean().item() == pytest.approx(0.8, abs=0.02)
    assert ((trace.deliveries > 0).sum(-1) == 2).all()


def test_every_scheduler_sees_the_same_channel():
    """With J = I nothing is left to decide: everybody transmits, so equal deliveries mean equal channels."""
    traces = [simulate_ages(s, 12, 12, 300, batch=3, seed=5) for s in ("round_robin", "max_age", "opportunistic")]
    for trace in traces[1:]:
        assert torch.equal(trace.deliveries, traces[0].deliveries)
        assert torch.equal(trace.mean_age, traces[0].mean_age)
    assert not torch.equal(simulate_ages("max_age", 12, 12, 300, batch=3, seed=6).mean_age, traces[0].mean_age)


def test_counts_survive_many_slots():
    trace = simulate_ages("oracle", 3, 1, 700, mean_snr_db=mean_snr_db_for(0.5))
    assert (trace.grants == 700).all()
    assert trace.deliveries.double().mean().item() == pytest.approx(350, abs=60)


@pytest.mark.slow
def test_less_channel_knowledge_means_older_information():
    system = SYSTEMS[0]
    ages = [simulated_age("channel_aware", *system, csi=csi) for csi in ("perfect", "statistical")]
    assert ages[0] < 0.8 * ages[1]
    # devices that are alike are all that acknowledgements can tell of, and what they learn is noisy
    assert ages[1] == pytest.approx(simulated_age("max_age", *system), rel=1e-6)
    assert simulated_age("channel_aware", *system, csi="acks") < 1.03 * ages[1]


@pytest.mark.parametrize("scheduler", WITHOUT_A_PLANT)
def test_delayed_knowledge_of_independent_fading_schedules_as_statistical_does(scheduler):
    snr_db = torch.linspace(0, 20, 10)
    traces = [simulate_ages(scheduler, 10, 2, 300, csi=csi, mean_snr_db=snr_db) for csi in ("delayed", "statistical")]
    assert torch.equal(traces[0].mean_age, traces[1].mean_age)
    assert torch.equal(traces[0].grants, traces[1].grants)


def test_resetting_on_scheduling_flatters_the_age():
    system = SYSTEMS[0]
    printed = simulated_age("round_robin", *system, aoi_reset="scheduled", slots=500)
    assert printed == pytest.approx(3.0, abs=0.02)


def test_unequal_links():
    snr_db = torch.tensor([30.0] * 5 + [0.0] * 5)
    trace = simulate_ages("opportunistic", 10, 2, 2000, mean_snr_db=snr_db)
    assert trace.deliveries[0, :5].min() > 10 * trace.deliveries[0, 5:].max()


@pytest.mark.parametrize("success", [0.3, 1.0])
def test_a_large_fleet_has_the_closed_form_of_many_candidates(success):
    devices, blocks = 5000, 10  # nearly always more than ten would succeed
    assert mean_age_opportunistic(devices, blocks, success) == pytest.approx(devices / blocks, rel=1e-9)


def test_bad_input_is_rejected():
    with pytest.raises(ValueError, match="unknown csi"):
        simulate_ages("max_age", 4, 1, 10, csi="guess")
    with pytest.raises(ValueError, match="aoi_reset"):
        simulate_ages("max_age", 4, 1, 10, aoi_reset="x")
    with pytest.raises(ValueError, match="slots"):
        simulate_ages("max_age", 4, 1, 0)
    with pytest.raises(ValueError, match="J to divide I"):
        mean_age_round_robin(10, 3, 0.5)
    with pytest.raises(ValueError, match="success probability"):
        mean_age_random(10, 3, 0.0)
    with pytest.raises(ValueError, match="J <= I"):
        mean_age_opportunistic(3, 10, 0.5)
