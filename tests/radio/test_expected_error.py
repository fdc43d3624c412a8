"""What a controller learns of its own errors, on errors whose law is known."""

import pytest
import torch

from tsjepa.radio.expected_error import expected_error, expected_gain, learn, pack, situation, start_record, unpack

SMALL = torch.zeros(6)
HEARD = torch.ones(6, dtype=torch.bool)


def taught(law, rounds=400, devices=6, largest_age=16):
    """The record of a fleet whose errors are ``law(age, device)`` times an exponential draw."""
    generator, record = torch.Generator().manual_seed(0), start_record((devices,))
    device = torch.arange(devices)
    for _ in range(rounds):
        age = torch.randint(1, largest_age + 1, (devices,), generator=generator)
        noise = torch.empty(devices, dtype=torch.float64).exponential_(generator=generator)
        cell = situation(age, SMALL, HEARD)
        record = learn(record, cell, law(age, device) * noise, HEARD)
    return record


def expects(record, age, command=0.0, informed=True):
    cell = situation(torch.full((6,), age), torch.full((6,), command), torch.full((6,), informed))
    return expected_error(record, cell)


def test_before_anything_is_heard_older_information_is_worse():
    values = torch.stack([expects(start_record((6,)), age)[0] for age in (1, 2, 8, 100, 5000)])
    assert (values.diff() > 0).all()


def test_it_learns_the_law_of_the_age():
    record = taught(lambda age, device: 0.02 * 1.15 ** age.double(), rounds=1200)
    for age in (1, 2, 4, 8, 13):
        assert expects(record, age).mean().item() == pytest.approx(0.02 * 1.15**age, rel=0.15)


def test_what_hearing_saves_is_the_sum_of_what_errors_have_grown():
    record = taught(lambda age, device: 0.02 * age.double())
    error = torch.stack([expects(record, age)[0] for age in range(1, 31)])
    for age in (1, 2, 7, 30):
        gain = expected_gain(record, situation(torch.full((6,), age), SMALL, HEARD))[0]
        assert gain.item() == pytest.approx((error[age - 1] - error[:age]).sum().item(), abs=1e-9)
    assert gain > 0


def test_an_age_that_was_never_seen_is_no_better_than_those_that_were():
    record = taught(lambda age, device: 0.02 * 1.3 ** age.double())
    values = torch.stack([expects(record, age)[0] for age in (8, 12, 16, 30, 60, 500)])
    assert (values.diff() >= 0).all()


def test_it_learns_who_is_worse_than_the_fleet():
    record = taught(lambda age, device: (0.01 + 0.03 * (device == 2)) * age.double())
    values = expects(record, 8)
    assert (values[2] / values[torch.arange(6) != 2]).min() > 3


def test_devices_that_are_alike_are_taken_for_alike():
    values = expects(taught(lambda age, device: 0.02 * age.double(), devices=6), 8)
    assert values.max() / values.min() < 1.1


def test_situations_are_kept_apart():
    record, cell = start_record((6,)), situation(torch.full((6,), 4), torch.full((6,), 0.5), HEARD)
    other = situation(torch.full((6,), 4), torch.full((6,), 0.1), HEARD)
    for _ in range(100):
        record = learn(learn(record, cell, torch.full((6,), 3.0), HEARD), other, torch.full((6,), 0.2), HEARD)
    assert expects(record, 4, command=0.5)[0].item() == pytest.approx(3.0, rel=0.05)
    assert expects(record, 4, command=0.1)[0].item() == pytest.approx(0.2, rel=0.3)
    assert expects(record, 20, command=0.5)[0] >= 3.0
    assert torch.equal(expects(record, 4, informed=False), expects(start_record((6,)), 4, informed=False))


def test_who_was_never_heard_comes_first_until_something_else_is_learned():
    record, age = start_record((6,)), torch.full((6,), 3)
    never = expected_gain(record, situation(age, SMALL, ~HEARD))
    assert (never > 10 * expected_gain(record, situation(10 * age, torch.ones(6), HEARD))).all()


def test_who_is_silent_teaches_nothing_and_the_record_survives_packing():
    record = taught(lambda age, device: 0.1 * age.double(), rounds=20)
    silent = learn(record, situation(torch.full((6,), 3), SMALL, HEARD), torch.full((6,), torch.nan), ~HEARD)
    for before, after, packed in zip(record, silent, unpack(pack(record)), strict=True):
        assert torch.equal(before, after) and torch.equal(before, packed)


def test_any_batch_is_learned_on_its_own():
    laws = (lambda age, device: 0.1 * age.double(), lambda age, device: 0.4 * age.double())
    records = [taught(law, rounds=50) for law in laws]
    both = unpack(torch.stack([pack(record) for record in records]))
    cell = situation(torch.full((2, 6), 7), torch.zeros(2, 6), torch.ones(2, 6, dtype=torch.bool))
    torch.testing.assert_close(expected_error(both, cell), torch.stack([expects(record, 7) for record in records]))
