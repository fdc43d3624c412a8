"""What a controller learns of its own errors, on errors whose law is known."""

import pytest
import torch

from tsjepa.radio.expected_error import expected_errors, expected_gain, learn, situation, start_record

HEARD = torch.ones(6, dtype=torch.bool)


def expected_error(record, situations):
    """Error that is expected of each device, [..., I]."""
    return expected_errors(record).flatten(-2).gather(-1, situations)


def taught(law, rounds=400, largest_age=16):
    """The record of a fleet of 6 whose errors are ``law(age)`` times an exponential draw."""
    generator, record = torch.Generator().manual_seed(0), start_record((6,))
    for _ in range(rounds):
        age = torch.randint(1, largest_age + 1, (6,), generator=generator)
        noise = torch.empty(6, dtype=torch.float64).exponential_(generator=generator)
        record = learn(record, situation(age, HEARD), law(age.double()) * noise, HEARD)
    return record


def expects(record, age, informed=True, what=expected_error):
    values = what(record, situation(torch.full((6,), age), torch.full((6,), informed)))
    assert (values == values[0]).all()
    return values[0].item()


@pytest.mark.parametrize("informed", [True, False])
def test_before_anything_is_heard_older_information_is_worse(informed):
    values = [expects(start_record((6,)), age, informed) for age in (1, 2, 8, 100, 512)]
    assert values == sorted(set(values))
    assert expects(start_record((6,)), 5000, informed) == values[-1]


def test_it_learns_the_law_of_the_age():
    record = taught(lambda age: 0.02 * 1.15**age, rounds=1200)
    for age in (1, 2, 4, 8, 13):
        assert expects(record, age) == pytest.approx(0.02 * 1.15**age, rel=0.15)


def test_an_age_that_was_never_seen_is_no_better_than_those_that_were():
    record = taught(lambda age: 0.02 * 1.3**age)
    values = [expects(record, age) for age in (8, 12, 16, 30, 60, 500)]
    assert values == sorted(values)


def test_what_hearing_saves_is_the_sum_of_what_errors_have_grown():
    record = taught(lambda age: 0.02 * age)
    error = [expects(record, age) for age in range(1, 31)]
    for age in (1, 2, 7, 30):
        grown = sum(error[age - 1] - before for before in error[:age])
        assert expects(record, age, what=expected_gain) == pytest.approx(grown, abs=1e-9)
    assert grown > 0


def test_the_devices_that_were_never_heard_have_errors_of_their_own():
    record, cell = taught(lambda age: 0.02 * age, rounds=50), situation(torch.full((6,), 4), ~HEARD)
    before = expects(record, 4)
    for _ in range(100):
        record = learn(record, cell, torch.full((6,), 0.7), HEARD)
    assert expects(record, 4, informed=False) == pytest.approx(0.7, rel=0.02)
    assert expects(record, 4) == before
    # once heard, such a device errs no more than the others
    saved = sum(0.7 - expects(record, age) for age in range(1, 5))
    assert expects(record, 4, informed=False, what=expected_gain) == pytest.approx(saved, rel=0.05)


def test_who_was_never_heard_comes_first_until_something_else_is_learned():
    record = start_record((6,))
    assert expects(record, 3, False, expected_gain) > 3 * expects(record, 30, True, expected_gain)


def test_who_is_silent_teaches_nothing():
    record = taught(lambda age: 0.1 * age, rounds=20)
    silent = learn(record, situation(torch.full((6,), 3), HEARD), torch.full((6,), torch.nan), ~HEARD)
    assert all(torch.equal(before, after) for before, after in zip(record, silent, strict=True))


def test_any_batch_is_learned_on_its_own():
    records = [taught(lambda age: 0.1 * age, rounds=50), taught(lambda age: 0.4 * age, rounds=50)]
    both = type(records[0])(*(torch.stack(parts) for parts in zip(*records, strict=True)))
    cell = situation(torch.full((2, 6), 7), torch.ones(2, 6, dtype=torch.bool))
    for row, record in zip(expected_error(both, cell), records, strict=True):
        torch.testing.assert_close(row, expected_error(record, cell[0]))
