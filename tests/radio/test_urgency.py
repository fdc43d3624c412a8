"""Urgency codes: levels, saturation, bits."""

import math

import pytest
import torch

from tsjepa.radio.urgency import UrgencyCode


def test_levels_are_even_in_decibels():
    code = UrgencyCode(3, full_scale=64.0, smallest=1.0)
    assert code.levels().tolist() == pytest.approx([0, 1, 2, 4, 8, 16, 32, 64])
    urgency = torch.tensor([0.0, 0.99, 1.0, 3.9, 4.0, 63.0, 64.0, 1e9, math.inf])
    assert code.encode(urgency).tolist() == [0, 0, 1, 2, 3, 6, 7, 7, 7]


@pytest.mark.parametrize("bits", [1, 4, 8])
def test_what_is_read_never_exceeds_what_was_said_and_keeps_the_order(bits):
    code = UrgencyCode(bits, full_scale=20.0, smallest=0.01)
    urgency = torch.linspace(0, 30, 5000, dtype=torch.float64)
    read = code.decode(code.encode(urgency))
    assert (read <= urgency + 1e-9).all() and (read.diff() >= 0).all()
    assert torch.equal(code.encode(code.levels()), torch.arange(2**bits))
    assert code.encode(urgency).max() == 2**bits - 1
    if bits > 1:
        inside = (urgency >= 0.01) & (urgency < 20.0)
        step = (20.0 / 0.01) ** (1 / (2**bits - 2))
        assert (urgency[inside] / read[inside]).max() <= step * (1 + 1e-6)


def test_bits_are_counted_where_something_is_sent():
    code = UrgencyCode(4, full_scale=1.0, smallest=0.1)
    asked = torch.tensor([[True, False, True]])
    assert code.signalling_bits(asked).tolist() == [[4, 0, 4]]
    for devices, name in ((1, 0), (2, 1), (128, 7), (129, 8)):
        assert code.signalling_bits(torch.ones(devices), named=True).tolist() == [4 + name] * devices


def test_a_change_is_counted_in_codes_either_way():
    code = UrgencyCode(3, full_scale=64.0, smallest=1.0)
    said = torch.tensor([4.0, 4.0, 4.0, 4.0, 0.0])
    assert code.changed(torch.tensor([4.1, 8.0, 16.0, 1.0, 0.9]), said, 2).tolist() == [False, False, True, True, False]


def test_bad_input_is_rejected():
    with pytest.raises(ValueError, match="0 bits"):
        UrgencyCode(0, 1.0, 0.1)
    for smallest in (0.0, 1.0):
        with pytest.raises(ValueError, match=f"smallest urgency, {smallest:g}, must lie between 0 and 1"):
            UrgencyCode(4, 1.0, smallest)
    for bad in (-1.0, math.nan):
        with pytest.raises(ValueError, match="not a number"):
            UrgencyCode(4, 1.0, 0.1).encode(torch.tensor([bad]))
