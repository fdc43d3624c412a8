"""Beliefs of many devices at once are those of each by itself."""

import numpy as np
import pytest
from world import Graphs

from tsjepa.live.beliefs import HORIZON, Beliefs


def told(beliefs: Beliefs, device: int, slot: int, value: int, round_trip: int = 0) -> tuple[int, list[float]]:
    target, plans = beliefs.update(np.array([device]), np.array([slot]), np.array([round_trip]), np.uint8([[value, 0]]))
    return int(target[0]), plans[0, :, 0].tolist()


def test_an_update_of_its_own_slot_is_answered_from_its_embedding():
    beliefs = Beliefs(Graphs(), 3)
    assert told(beliefs, 1, 4, 50) == (4, [-5.0])
    assert beliefs.newest.tolist() == [-1, 4, -1]
    assert beliefs.age(np.array([1])).tolist() == [1]


def test_a_plan_predicts_through_its_own_commands():
    slot, plan = told(Beliefs(Graphs(), 1, buffer=3), 0, 0, 100)
    assert slot == 0
    assert plan == pytest.approx([-10.0, -9.0, -8.1])


def test_a_round_trip_aims_at_a_later_slot_through_what_was_sent():
    beliefs = Beliefs(Graphs(), 1)
    told(beliefs, 0, 0, 100)  # -10 in slot 0
    beliefs.predict(np.array([0]))  # -9 in slot 1
    assert told(beliefs, 0, 1, 80, round_trip=2) == (3, [pytest.approx(-0.1 * (80 - 9 - 9))])  # 2 was held from 1


@pytest.mark.parametrize(("buffer", "applied"), [(1, -10.0), (3, -9.0)])
def test_a_command_that_is_no_number_is_not_sent_and_the_one_before_goes_on(buffer, applied):
    graphs = Graphs()
    beliefs = Beliefs(graphs, 1, buffer)
    told(beliefs, 0, 0, 100)  # -10 in slot 0; of three commands the next is -9
    graphs.spoil = np.nan
    assert np.isnan(beliefs.predict(np.array([0]))[1]).all()  # of slot 1
    graphs.spoil = None
    slot, plan = told(beliefs, 0, 1, 80, round_trip=1)
    assert slot == 2
    assert plan[0] == pytest.approx(-0.1 * (80 + applied))


def test_a_device_whose_first_command_is_no_number_is_at_rest():
    graphs = Graphs()
    beliefs = Beliefs(graphs, 1)
    graphs.spoil = np.nan
    told(beliefs, 0, 0, 100)
    graphs.spoil = None
    assert told(beliefs, 0, 1, 100, round_trip=1) == (2, [-10.0])


def test_a_plan_is_played_in_slots_for_which_nothing_was_sent():
    beliefs = Beliefs(Graphs(), 1, buffer=3)
    told(beliefs, 0, 0, 100)  # -10, -9 and -8.1 in slots 0 to 2, and held
    slot, plan = told(beliefs, 0, 1, 80, round_trip=3)
    assert slot == 4
    assert plan[0] == pytest.approx(-0.1 * (80 - 9 - 8.1 - 8.1))


def test_an_update_that_comes_after_its_command_replaces_the_belief():
    beliefs = Beliefs(Graphs(), 1)
    told(beliefs, 0, 0, 100)
    for _ in range(3):
        beliefs.predict(np.array([0]))  # -9, -8.1, -7.29 in slots 1 to 3
    slot, plan = told(beliefs, 0, 1, 200)
    assert slot == 3
    assert plan == [pytest.approx(-0.1 * (200 - 9 - 8.1))]


def test_devices_do_not_meet():
    rng = np.random.default_rng(0)
    together, alone = Beliefs(Graphs(), 8, buffer=2), [Beliefs(Graphs(), 8, buffer=2) for _ in range(8)]
    newest = np.full(8, -1)
    for _ in range(60):
        device = rng.permutation(8)[: rng.integers(1, 9)]
        if rng.random() < 0.5 and (newest[device] >= 0).all():
            found = together.predict(device)
            expected = [alone[number].predict(np.array([number])) for number in device]
        else:
            slot, trip = newest[device] + rng.integers(1, 4, len(device)), rng.integers(0, 3, len(device))
            payload = rng.integers(0, 255, (len(device), 2), np.uint8)
            newest[device] = slot
            found = together.update(device, slot, trip, payload)
            expected = [
                alone[number].update(*(part[row : row + 1] for part in (device, slot, trip, payload)))
                for row, number in enumerate(device)
            ]
        np.testing.assert_array_equal(found[0], np.concatenate([target for target, _ in expected]))
        np.testing.assert_allclose(found[1], np.concatenate([plan for _, plan in expected]), rtol=1e-6)


def test_a_device_is_predicted_within_the_horizon_and_not_beyond():
    beliefs = Beliefs(Graphs(), 2)
    assert not beliefs.predictable().any()
    told(beliefs, 0, 10, 100)
    count = 0
    while beliefs.predictable()[0]:
        beliefs.predict(np.array([0]))
        count += 1
    assert count == HORIZON - 1
    assert told(beliefs, 0, 10 + HORIZON, 30)[1] == [-3.0]


def test_a_device_that_starts_anew_is_forgotten():
    beliefs = Beliefs(Graphs(), 1)
    told(beliefs, 0, 500, 100, round_trip=1)
    beliefs.forget(0)
    assert told(beliefs, 0, 0, 100) == (0, [-10.0])


def test_any_round_trip_and_any_gap_are_borne():
    beliefs = Beliefs(Graphs(), 1)
    told(beliefs, 0, 0, 100, round_trip=255)
    assert beliefs.told[0] == HORIZON - 1
    slot, plan = told(beliefs, 0, 10**6, 100)
    assert slot == 10**6 and plan == [-10.0]
