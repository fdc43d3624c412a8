import pytest
import torch
from scipy import stats

from tsjepa.evaluation.metrics import Run, interval, normalized_score
from tsjepa.evaluation.summary import score_by_slot, summary, table, watched_figures
from tsjepa.plants import CartPole

PLANT = CartPole()


def make_run(**changes) -> Run:
    """Two starts over four slots: the first enters the box, the second fails in its second slot."""
    state = torch.zeros(5, 2, 4)
    state[0, 0], state[1, 0] = torch.tensor([0.5, 0.1, 1.0, 2.0]), torch.tensor([0.06, 0.0, 0.0, 0.0])
    state[2, 0], state[3, 0] = torch.tensor([0.04, 0.04, 0.0, 0.0]), torch.tensor([0.04, -0.06, 0.0, 0.0])
    state[4, 0] = torch.tensor([-0.05, 0.05, 3.0, 0.0])
    state[1:, 1, 1] = torch.tensor([0.0, 0.9, 0.0, 0.0])
    action = torch.tensor([[10.0, -20.0]] * 4)[..., None]
    expert = torch.tensor([[12.0, 0.0]] * 4)[..., None]
    flags = torch.ones(4, 2, dtype=torch.bool)
    values = {
        "spec": PLANT.spec,
        "state": state,
        "action": action,
        "expert_action": expert,
        "score": PLANT.score(state[1:]).float(),
        "failed_now": PLANT.failed(state),
        "scheduled": flags,
        "delivered": torch.tensor([[True, False]] * 4),
        "age": torch.ones(4, 2, dtype=torch.int64),
        "payload_bits": torch.tensor([[100, 100], [0, 0], [100, 100], [0, 0]]),
        "used": torch.tensor([2, 1, 2, 1]),
        "capacity": 4,
        "cost": PLANT.cost(state[1:], action),
    }
    return Run(**(values | changes))


def test_raw_score_is_the_share_of_slots_that_end_in_the_box_until_a_failure():
    # the start itself does not count, the edge of the box does; back in the box after a fall does not
    assert make_run().slot_score().tolist() == [[0, 1], [1, 0], [0, 0], [1, 0]]
    assert make_run().raw_score().tolist() == [0.5, 0.25]


def test_a_start_that_has_failed_at_step_0_scores_nothing():
    run = make_run()
    run.failed_now[0, 0] = True
    assert run.raw_score().tolist() == [0.0, 0.25]


def test_a_start_fails_at_the_first_slot_outside_the_limits():
    assert make_run().failed().tolist() == [False, True]


def test_quadratic_cost_leaves_the_start_out_and_weighs_newtons_by_a_thousandth():
    states = 0.06**2 + (0.04**2 + 0.04**2) + (0.04**2 + 0.06**2) + (0.05**2 + 0.05**2 + 9)
    effort = 4 * 1e-3 * 10.0**2
    assert make_run().quadratic_cost()[0].item() == pytest.approx(0.5 * (states + effort))


def test_command_error_is_relative_to_the_actuators_range():
    assert make_run().command_nmae().tolist() == pytest.approx([2 / 40, 20 / 40])


def test_of_the_radio_what_was_delivered_and_what_was_used():
    assert make_run().delivery_rate() == 0.5
    assert make_run(scheduled=torch.zeros(4, 2, dtype=torch.bool), delivered=torch.zeros(4, 2)).delivery_rate() == 0
    assert make_run().utilisation() == pytest.approx(6 / 16)


def test_normalized_score_divides_sums():
    assert normalized_score(torch.tensor([0.2, 0.4]), torch.tensor([0.5, 1.0])) == pytest.approx(0.4)


@pytest.mark.parametrize("optimal", [0.0, float("nan")])
def test_where_the_normaliser_scores_nothing_there_is_no_score(optimal):
    with pytest.raises(ValueError, match="take more slots or more starts"):
        normalized_score(torch.tensor([0.0]), torch.tensor([optimal]))


@pytest.mark.parametrize("values", [[0.9, 1.0], [0.61, 0.7, 0.55, 0.72, 0.66]])
def test_interval_agrees_with_scipy(values):
    mean, half = interval(values)
    low, high = stats.t.interval(0.95, len(values) - 1, loc=mean, scale=stats.sem(values))
    assert mean - half == pytest.approx(low)
    assert mean + half == pytest.approx(high)


def test_an_interval_needs_two_seeds():
    with pytest.raises(ValueError, match="at least 2 seeds, not 1"):
        interval([0.5])


@pytest.mark.parametrize("period", [0, 2])
def test_a_row_has_the_means_over_starts_and_the_interval_over_seeds(period):
    runs, optimal = [make_run(), make_run()], [torch.tensor([0.5, 0.5]), torch.tensor([0.75, 0.75])]
    row = summary("TS-JEPA", period, runs, optimal)
    assert row["bits_per_step"] == 50
    assert row["update_every"] == (period or "once")
    assert row["per_seed"] == pytest.approx([0.75, 0.5])
    assert (row["normalized_score"], row["best_seed"]) == (pytest.approx(0.625), pytest.approx(0.75))
    assert row["interval_95"] == pytest.approx(stats.t.ppf(0.975, 1) * 0.125)
    assert row["raw_score"] == pytest.approx(0.375)
    assert (row["failures"], row["starts"]) == (2, 4)
    assert row["score_by_slot"] == [0.5, 0.5, 0.0, 0.5]
    assert "cost" in table({"closed_loop": [row]}).splitlines()[0]


def test_a_plant_without_a_cost_has_no_column_for_it():
    row = summary("TS-JEPA", 1, [make_run(cost=None)] * 2, [torch.ones(2)] * 2)
    assert "quadratic_cost" not in row
    assert "cost" not in table({"closed_loop": [row]})


def test_score_by_slot_is_the_mean_over_all_starts_of_all_seeds():
    assert score_by_slot([make_run(), make_run(score=torch.zeros(4, 2))]) == [0.25, 0.25, 0.0, 0.25]


def test_watched_figures_name_the_first_slot_whose_mean_error_is_too_large():
    errors = torch.tensor([[0.0, 0.02], [0.0, 0.09], [0.02, 0.1], [0.0, 0.0]])
    figures = watched_figures(errors, PLANT.spec)
    assert figures["watched"] == {"state": "theta", "limit": 0.05, "unit": "rad"}
    assert figures["first_slot_watched_error_above_limit"] == 2
    assert figures["watched_error_by_slot"] == pytest.approx([0.01, 0.045, 0.06, 0.0])
    assert watched_figures(errors[:2], PLANT.spec)["first_slot_watched_error_above_limit"] is None
