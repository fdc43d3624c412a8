"""The actuator's command for each slot, whatever the order in which packets come."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tsjepa.live.plans import KEPT, Plans


def plan(*values: float) -> np.ndarray:
    return np.float32(values)[:, None]


def test_there_is_no_command_before_the_first_packet():
    plans = Plans()
    assert plans.at(0) is None
    plans.put(2, 1, plan(5))
    assert plans.at(1) is None
    assert plans.at(2) == 5


def test_a_plan_is_played_and_its_last_command_held():
    plans = Plans()
    plans.put(0, 1, plan(1, 2, 3))
    assert [float(plans.at(slot)[0]) for slot in range(5)] == [1, 2, 3, 3, 3]
    assert plans.begun == 0


def test_the_newest_slot_wins_and_of_one_slot_what_was_sent_last():
    plans = Plans()
    plans.put(1, 5, plan(10, 11))
    plans.put(0, 6, plan(20, 21))  # sent later, for an earlier slot
    assert plans.at(1) == 10
    plans.put(1, 4, plan(30))  # sent earlier, arrives later
    assert plans.at(1) == 10
    plans.put(1, 7, plan(40))
    assert plans.at(1) == 40


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(1, 4)), max_size=40))
def test_what_is_kept_is_bounded_and_gives_the_newest(packets):
    plans, given_ = Plans(), {}
    for sequence, (slot, length) in enumerate(packets):
        commands = np.full((length, 1), sequence, np.float32)
        plans.put(slot, sequence, commands)
        given_[slot] = sequence, length
        assert len(plans._plans) <= KEPT
    kept = sorted(given_)
    newest = [slot for slot in kept if slot <= 30]
    if newest:
        assert plans.at(30) == given_[newest[-1]][0]


def test_the_round_trip_leaves_out_two_of_sixteen():
    plans = Plans()
    assert plans.round_trip == 0
    for slots in [1] * 14 + [9, 9]:
        plans.measure(slots)
    assert plans.round_trip == 1
    plans.measure(9)
    assert plans.round_trip == 9
    for _ in range(16):
        plans.measure(-3)
    assert plans.round_trip == 0
