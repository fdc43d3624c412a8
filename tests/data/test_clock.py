"""The clocks of rows and pictures, gaps, resampling and the lag, against constructed answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsjepa.data.clock import cut, match_clocks, newest, stamp_faults
from tsjepa.data.lag import command_lag, common_lag

TWENTY_HZ = np.arange(40) / 20


def clocks(rows, frames, **options):
    return match_clocks(rows, frames, len(rows), len(frames), **{"paired": False, "rate_hz": None, **options})


def every_row(found):
    return np.ones(len(found.rows), bool)


@pytest.mark.parametrize("offset", [0.05, -0.3, 1_700_000_000.0])
def test_the_offset_between_clocks_of_as_many_rows_as_pictures_is_found_and_said(offset):
    found = clocks(TWENTY_HZ + offset, TWENTY_HZ)
    assert found.offset == pytest.approx(offset, abs=1e-6)
    assert found.paired and "against that of the pictures" in found.notes[0]
    pieces, _ = cut(found, every_row(found), None, True)
    np.testing.assert_array_equal(pieces[0].frame, pieces[0].row)


def test_a_given_offset_is_used_instead():
    found = clocks(TWENTY_HZ + 0.05, TWENTY_HZ, offset=0.0)
    (piece,), _ = cut(found, every_row(found), None, True)
    np.testing.assert_array_equal(piece.frame, piece.row + 1)


def test_clocks_that_drift_are_said():
    found = clocks(TWENTY_HZ * 1.04, TWENTY_HZ)
    assert any("drift apart by 8" in note for note in found.notes)  # 4 % of 2 s


def test_unlike_streams_on_one_clock_keep_their_stamps():
    rows = np.arange(0, 2, 0.01)
    found = clocks(rows, TWENTY_HZ + 0.5)
    assert found.offset == 0 and not found.paired


def test_unlike_streams_without_a_common_time_are_laid_together_at_their_starts():
    found = clocks(1e6 + np.arange(0, 2, 0.01), TWENTY_HZ)
    assert found.offset == pytest.approx(1e6) and any("starts are laid together" in note for note in found.notes)


def test_without_any_times_a_rate_is_asked_for():
    with pytest.raises(ValueError, match="--rate_hz"):
        match_clocks(None, None, 8, 8, True, None)
    found = match_clocks(None, None, 8, 8, True, 20)
    np.testing.assert_allclose(found.frames, np.arange(8) / 20)


def test_stamps_that_repeat_or_go_back_are_named():
    repeats, back = stamp_faults(np.array([0, 1, 1, 2, 1.5, 3]), "rows")
    assert repeats == "1 times of rows repeat (first at 2)." and back == "1 times of rows go back (first at 4)."


def test_one_picture_more_than_commands():
    found = match_clocks(TWENTY_HZ[:-1], TWENTY_HZ, 39, 40, True, None)
    (piece,), _ = cut(found, every_row(found), None, row_needed=False)
    assert len(piece.frame) == 40 and piece.frame[-1] == 39
    (piece,), _ = cut(found, every_row(found), None, row_needed=True)  # its state is not known
    assert len(piece.frame) == 39


def test_a_last_row_without_a_command_keeps_its_picture():
    """Recorders that step an environment leave NaN for the command after the last picture."""
    found = match_clocks(None, TWENTY_HZ, 40, 40, True, None)
    usable = every_row(found)
    usable[-1] = False
    (piece,), notes = cut(found, usable, None, row_needed=False)
    assert len(piece.frame) == 40 and not notes


def test_a_gap_and_a_step_back_split_an_episode():
    times = np.concatenate([TWENTY_HZ, 100 + TWENTY_HZ, TWENTY_HZ])
    found = match_clocks(times, times, 120, 120, True, None)
    pieces, notes = cut(found, every_row(found), None, True)
    assert [len(piece.frame) for piece in pieces] == [40, 40, 40]
    assert "1 gaps of 98.0 s" in notes[0] or "1 gaps of 98.1 s" in notes[0]


def test_rows_without_a_command_split_an_episode():
    found = match_clocks(TWENTY_HZ, TWENTY_HZ, 40, 40, True, None)
    usable = every_row(found)
    usable[[10, 11]] = False
    pieces, notes = cut(found, usable, None, True)
    assert [(piece.frame[0], piece.frame[-1]) for piece in pieces] == [(0, 9), (12, 39)]
    assert notes == ["2 of 40 rows have no finite command or state; it is split there."]


@pytest.mark.parametrize("slot", [0.02, 0.05, 0.07])
def test_resampling_holds_commands_and_never_takes_a_later_picture(slot):
    generator = np.random.default_rng(1)
    frames = np.cumsum(generator.uniform(0.03, 0.07, 60))
    rows = np.cumsum(generator.uniform(0.01, 0.05, 110)) + 0.02
    found = clocks(rows, frames)
    (piece,), _ = cut(found, every_row(found), slot, True)
    for place, (frame, row) in enumerate(zip(piece.frame, piece.row, strict=True)):
        now = piece.start + place * slot + 1e-3 * slot
        assert frames[frame] <= now and rows[row] <= now
        assert frame == len(frames) - 1 or frames[frame + 1] > now
        assert row == len(rows) - 1 or rows[row + 1] > now
    assert len(piece.frame) == pytest.approx((frames[-1] - piece.start) / slot, abs=2)


def test_even_pictures_are_taken_as_they_are_although_their_stamps_are_rounded():
    stamps = np.round(np.arange(300) / 30, 3)
    found = match_clocks(stamps, stamps, 300, 300, True, 30)
    found.interval = 1 / 30
    (piece,), _ = cut(found, every_row(found), None, True)
    np.testing.assert_array_equal(piece.frame, np.arange(300))


@given(st.lists(st.floats(0, 10), min_size=1, max_size=30), st.floats(0, 10))
def test_newest_is_the_last_that_is_not_later(times, at):
    times = np.sort(times)
    index = newest(times, np.array([at]), 0.0)[0]
    before = np.flatnonzero(times <= at)
    assert index == (before[-1] if len(before) else 0)


@pytest.mark.parametrize("lag", [0, 3, 9])
def test_the_lag_of_a_state_behind_a_command_of_the_same_kind(lag):
    generator = np.random.default_rng(0)
    command = np.cumsum(generator.normal(size=(300, 4)), axis=0)
    state = np.roll(command, lag, axis=0)
    state[:lag] = command[0]
    assert command_lag(command, state, 1 / 30, same=True) == (lag, lag, lag)


@pytest.mark.parametrize("lag", [0, 2, 5])
def test_the_lag_of_a_force_on_a_mass(lag):
    """x' = v, v' = u(t - lag): the command explains the next change of the velocity, and of nothing earlier."""
    generator = np.random.default_rng(0)
    force = generator.normal(size=(400, 1))
    state = np.zeros((400, 2))
    for row in range(399):
        push = force[row - lag, 0] if row >= lag else 0.0
        state[row + 1] = state[row] + [0.02 * state[row, 1], push]
    assert command_lag(force, state, 0.02, same=False) == (lag, lag, lag)


def test_no_lag_is_claimed_where_nothing_follows():
    generator = np.random.default_rng(0)
    assert command_lag(generator.normal(size=(300, 2)), generator.normal(size=(300, 3)), 0.05, same=False) is None
    assert command_lag(generator.normal(size=(300, 2)), generator.normal(size=(300, 2)), 0.05, same=True) is None
    assert command_lag(generator.normal(size=(300, 2)), generator.random((299, 1)), 0.05, same=False) is None


@pytest.mark.parametrize("states", [1, 2, 4])
def test_short_episodes_that_have_nothing_to_do_with_their_commands_show_no_lag(states):
    """In so few rows a smooth state goes with some earlier command by chance."""
    generator, found = np.random.default_rng(0), 0
    for _ in range(40):
        command, state = generator.normal(size=(2, 30, states))
        for row in range(1, 30):
            command[row] += 0.9 * command[row - 1]
            state[row] += 0.9 * state[row - 1]
        found += command_lag(command[:, :1], state, 0.05, same=states == 1) is not None
    assert found <= 1


def test_a_lag_of_few_columns_is_none_of_the_whole():
    generator = np.random.default_rng(0)
    command, state = generator.normal(size=(2, 300, 5))
    for following, expected in ((2, None), (3, (4, 4, 4))):
        state[:, :following] = np.roll(command[:, :following], 4, axis=0)
        assert command_lag(command, state, 0.05, same=True) == expected
    command[:, 3:] = 1.0  # columns that never change are no evidence against it
    assert command_lag(command, state, 0.05, same=True) == (4, 4, 4)


def test_a_recording_has_the_lag_that_half_of_its_rows_agree_on():
    four, five, twenty = (4, 3, 6), (5, 5, 5), (20, 18, 22)
    assert common_lag([four] * 2 + [None] * 22, [100] * 24) is None
    assert common_lag([four] * 12 + [None] * 12, [100] * 24) == four
    assert common_lag([four, twenty, None], [100] * 3) is None
    assert common_lag([four, four, five, twenty], [100] * 4) == four
    assert common_lag([four, None, None], [100, 30, 30]) == four  # a long episode says more than two short ones
    assert common_lag([twenty, (23, 21, 25)], [100] * 2) == (21, 19, 23)
    assert common_lag([None], [100]) is None and common_lag([], []) is None


def test_a_jump_that_only_the_rows_know_of_splits_an_episode():
    """Two episodes joined, or a pause that the video does not show."""
    for jump in (30.0, -0.7):
        rows = TWENTY_HZ + np.where(np.arange(40) >= 25, jump, 0)
        found = clocks(rows, TWENTY_HZ, paired=True)
        pieces, notes = cut(found, every_row(found), None, True)
        assert [(piece.frame[0], piece.frame[-1]) for piece in pieces] == [(0, 24), (25, 39)]
        assert "jumps 1 times where that of the pictures does not" in notes[0]
