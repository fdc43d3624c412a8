"""Datagrams: their layout, and that nothing else is taken for one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsjepa.live import packet
from tsjepa.live.packet import (
    COMMAND,
    HEADER,
    LARGEST,
    UPDATE,
    Command,
    Dropped,
    Header,
    Update,
    most_commands,
    read_command,
    read_header,
    read_update,
)

LOW, HIGH = np.float32([-20, -1]), np.float32([20, 1])
HEAD = Header(UPDATE, 513, 0x0102030405060708, 9, 0x1112131415161718, 10, -2)


def test_the_layout_is_the_documented_one():
    assert HEAD.pack().hex() == "0101020101020304050607080000000911121314151617180000000afffffffe"
    assert Update(3, b"\x07\x08").pack() == b"\x03\x07\x08"
    plan = np.float32([[1.0, -0.5]])
    assert Command(-1, True, plan).pack().hex() == "ffffffff0101023f800000bf000000"


@given(st.sampled_from([1, 2, 3]), *[st.integers(0, 2**bits - 1) for bits in (16, 64, 32, 64, 32)], st.booleans())
def test_a_header_comes_back(kind, device, session, sequence, peer, echo, sealed):
    header = Header(kind, device, session, sequence, peer, echo, -5, sealed)
    assert read_header(header.pack()) == header


@given(st.binary(max_size=200))
def test_any_bytes_are_a_header_or_dropped_for_a_reason(data):
    try:
        header = read_header(data)
    except Dropped as drop:
        assert drop.args[0] in ("size", "version", "kind")
    else:
        assert header.pack() == data[: HEADER.size]


def test_what_is_too_short_too_long_or_of_another_version_is_dropped():
    whole = HEAD.pack()
    cases = [
        (whole[:-1], "size"),
        (b"", "size"),
        (whole + bytes(LARGEST - 31), "size"),
        (b"\x02" + whole[1:], "version"),
    ]
    cases += [(whole[:1] + bytes([kind]) + whole[2:], "kind") for kind in (0, 4, 127, 128, 255)]
    for data, reason in cases:
        with pytest.raises(Dropped, match=reason):
            read_header(data)


def test_an_update_has_the_payload_of_the_model():
    assert read_update(Update(7, b"abcd").pack(), 4) == Update(7, b"abcd")
    for length in (0, 4, 6):
        with pytest.raises(Dropped, match="shape"):
            read_update(bytes(length), 4)


def test_a_command_comes_back_and_every_truncated_one_is_dropped():
    plan = np.float32([[1.5, 0.25], [-20, 1]])
    body = Command(17, False, plan).pack()
    answers, prompt, found = read_command(body, LOW, HIGH)
    assert (answers, prompt) == (17, False)
    np.testing.assert_array_equal(found, plan)
    for size in range(len(body)):
        with pytest.raises(Dropped, match="shape"):
            read_command(body[:size], LOW, HIGH)
    with pytest.raises(Dropped, match="shape"):
        read_command(body, LOW[:1], HIGH[:1])
    with pytest.raises(Dropped, match="shape"):
        read_command(Command(0, True, plan[:0]).pack(), LOW, HIGH)


@pytest.mark.parametrize("wrong", [20.1, -21, np.nan, np.inf])
def test_a_command_that_the_actuator_does_not_take_is_dropped(wrong):
    with pytest.raises(Dropped, match="range"):
        read_command(Command(0, True, np.float32([[0, 0], [wrong, 0]])).pack(), LOW, HIGH)


def test_the_longest_plan_fits_a_packet():
    for width in (1, 2, 40, 255):
        plan = np.zeros((most_commands(width), width), np.float32)
        size = HEADER.size + len(Command(0, True, plan).pack()) + 16
        assert size <= LARGEST
        assert len(plan) == 255 or size + 4 * width > LARGEST
    assert COMMAND != packet.HELLO
