import pytest
import torch
from scipy import stats
from tsjepa.plants.score import has_failed, in_box

from tsjepa.evaluation.evaluate import score_by_slot, summary
from tsjepa.evaluation.metrics import Run, interval, normalized_score


def make_run() -> Run:
    """Two starts over four slots: the first enters the box, the second falls."""
    state = torch.zeros(5, 2, 4)
    state[0, 0], state[1, 0] = torch.tensor([0.5, 0.1, 1.0, 2.0]), torch.tensor([0.06, 0.0, 0.0, 0.0])
    state[2, 0], state[3, 0] = torch.tensor([0.04, 0.04, 0.0, 0.0]), torch.tensor([0.04, -0.06, 0.0, 0.0])
    state[4, 0] = torch.tensor([-0.05, 0.05, 3.0, 0.0])
    state[1:, 1, 1] = torch.tensor([0.3, 0.7, 0.9, 0.1])
    action = torch.tensor([[10.0, -20.0]] * 4)[..., None]
    expert = torch.tensor([[12.0, 0.0]] * 4)[..., None]
    return Run(state, action, expert)


def test_raw_score_is_the_share_of_slots_that_end_in_the_box():
    # the start itself does not count, the edge of the box does
    assert make_run().raw_score().tolist() == [0.5, 0.0]


def test_numpy_states_and_tensors_are_scored_alike():
    state = make_run().state
    assert in_box(state.numpy()).tolist() == in_box(state).tolist()
    assert has_failed(state.numpy()).tolist() == has_failed(state).tolist()
    assert in_box(state).any()
    assert has_failed(state).any()


def test_a_start_fails_at_the_first_slot_outside_the_limits():
    run = make_run()
    assert run.failed().tolist() == [False, True]
    run.state[2, 0, 0] = -1.81
    assert run.failed().tolist() == [True, True]


def test_quadratic_cost_leaves_the_start_out_and_weighs_newtons_by_a_thousandth():
    states = 0.06**2 + (0.04**2 + 0.04**2) + (0.04**2 + 0.06**2) + (0.05**2 + 0.05**2 + 9)
    effort = 4 * 1e-3 * 10.0**2
    assert make_run().quadratic_cost()[0].item() == pytest.approx(0.5 * (states + effort))


def test_command_error_is_relative_to_the_actuators_range():
    assert make_run().command_nmae().tolist() == pytest.approx([2 / 40, 20 / 40])


def test_normalized_score_divides_sums():
    assert normalized_score(torch.tensor([0.2, 0.4]), torch.tensor([0.5, 1.0])) == pytest.approx(0.4)


@pytest.mark.parametrize("values", [[0.9, 1.0], [0.61, 0.7, 0.55, 0.72, 0.66]])
def test_interval_agrees_with_scipy(values):
    mean, half = interval(values)
    low, high = stats.t.interval(0.95, len(values) - 1, loc=mean, scale=stats.sem(values))
    assert mean - half == pytest.approx(low)
    assert mean + half == pytest.approx(high)


def test_an_interval_needs_two_seeds():
    with pytest.raises(ValueError, match="at least 2 seeds, not 1"):
        interval([0.5])


@pytest.mark.parametrize(("period", "updates"), [(1, 4), (3, 2), (0, 1), (10, 1)])
def test_a_row_counts_the_bits_of_the_updates_that_were_sent(period, updates):
    runs, optimal = [make_run(), make_run()], [torch.tensor([0.5, 0.5])] * 2
    row = summary("TS-JEPA", period, runs, optimal, bits=100, slots=4)
    assert row["bits_per_step"] == 100 * updates / 4
    assert row["update_every"] == (period or "once")
    assert row["normalized_score"] == pytest.approx(0.5)
    assert row["interval_95"] == pytest.approx(0.0)
    assert (row["failures"], row["starts"]) == (2, 4)


def test_score_by_slot_is_the_share_of_starts_in_the_box():
    assert score_by_slot([make_run()]) == [0.0, 0.5, 0.0, 0.5]
