"""What travels: the layout of a datagram, in network byte order. docs/how-to/live.md shows it.

Every datagram starts with 32 bytes:

    offset  bytes
    0       1     version, 1
    1       1     kind: 1 update, 2 command, 3 hello; plus 128 where the body is sealed
    2       2     number of the device
    4       8     session of the sender: random, drawn when it starts
    12      4     sequence number within that session, from 1
    16      8     session of the receiver as the sender knows it, 0 for none
    24      4     largest sequence number that the sender has heard from that session
    28      4     slot, signed: of an update's newest frame, or the first slot that a command is for

The body of an update is the round trip in slots (1 byte) and the codec's payload. The body of a command is the slot of
the newest update that it rests on (4, signed), whether it answers an update at once (1), the number of slots N (1), of
numbers in a command m (1), and N x m floats of 4 bytes. A hello has no body. A sealed body is 16 bytes longer.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

VERSION = 1
UPDATE, COMMAND, HELLO = 1, 2, 3
SEALED = 128  # added to the kind
LARGEST = 1232  # bytes: what IPv6's smallest MTU, 1280, leaves to UDP
HEADER = struct.Struct("!BBHQIQIi")
NONCE = slice(4, 16)  # session and sequence, which never come again together
_COMMAND = struct.Struct("!iBBB")


class Dropped(Exception):
    """A datagram that is not used; its argument is the reason under which it is counted."""


class Header(NamedTuple):
    """The first 32 bytes of a datagram, see above."""

    kind: int
    device: int
    session: int
    sequence: int
    peer: int
    echo: int
    slot: int
    sealed: bool = False

    def pack(self) -> bytes:
        """As bytes."""
        kind = self.kind + SEALED * self.sealed
        return HEADER.pack(VERSION, kind, self.device, self.session, self.sequence, self.peer, self.echo, self.slot)


class Update(NamedTuple):
    """What a device sends: its round trip in slots, and the payload."""

    round_trip: int
    payload: bytes

    def pack(self) -> bytes:
        """As bytes."""
        return bytes((self.round_trip,)) + self.payload


class Command(NamedTuple):
    """What a controller sends.

    Args:
        answers: slot of the newest update that the commands rest on.
        prompt: whether that update has just arrived.
        plan: float32 [N, m], for the packet's slot and those after it.
    """

    answers: int
    prompt: bool
    plan: np.ndarray

    def pack(self) -> bytes:
        """As bytes."""
        return _COMMAND.pack(self.answers, self.prompt, *self.plan.shape) + self.plan.astype(">f4").tobytes()


def read_header(data: bytes) -> Header:
    """The header of a datagram.

    Raises:
        Dropped: "size", "version" or "kind".
    """
    if not HEADER.size <= len(data) <= LARGEST:
        raise Dropped("size")
    version, kind, *rest = HEADER.unpack_from(data)
    if version != VERSION:
        raise Dropped("version")
    if kind & ~SEALED not in (UPDATE, COMMAND, HELLO):
        raise Dropped("kind")
    return Header(kind & ~SEALED, *rest, sealed=kind >= SEALED)


def read_update(body: bytes, payload_bytes: int) -> Update:
    """The body of an update.

    Raises:
        Dropped: "shape", where its payload is not of ``payload_bytes``.
    """
    if len(body) != 1 + payload_bytes:
        raise Dropped("shape")
    return Update(body[0], body[1:])


def read_command(body: bytes, low: np.ndarray, high: np.ndarray) -> Command:
    """The body of a command for an actuator of the range ``low`` to ``high`` [m].

    Raises:
        Dropped: "shape", or "range" for a number that the actuator does not take.
    """
    if len(body) < _COMMAND.size:
        raise Dropped("shape")
    answers, prompt, count, width = _COMMAND.unpack_from(body)
    if width != len(low) or not count or len(body) != _COMMAND.size + 4 * count * width:
        raise Dropped("shape")
    plan = np.frombuffer(body, ">f4", offset=_COMMAND.size).astype(np.float32).reshape(count, width)
    if not ((plan >= low) & (plan <= high)).all():  # NaN is neither
        raise Dropped("range")
    return Command(answers, bool(prompt), plan)


def most_commands(width: int) -> int:
    """Commands of ``width`` numbers that a sealed packet has room for."""
    return min(255, (LARGEST - HEADER.size - _COMMAND.size - 16) // (4 * width))
