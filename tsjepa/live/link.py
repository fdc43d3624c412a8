"""One end of the conversation between a device and its controller: which packets are news, and which are replays."""

from __future__ import annotations

import secrets
from collections import deque

from tsjepa.live.packet import HELLO, Dropped, Header

WINDOW = 64  # packets by which one may be overtaken, and by which an echo may lag
LAST_SEQUENCE = 2**32 - 1


class Link:
    """Sessions and sequence numbers of one device, at either end.

    Both ends name a random session of their own in what they send, and echo the other's session and its largest
    sequence number. A packet counts if it names this end's session and echoes a number of the last :data:`WINDOW` that
    this end has sent. So whoever recorded packets can use none of them later: not after either end has started anew,
    and not within a session, where a sequence number counts once.

    Args:
        device: its number.
    """

    def __init__(self, device: int) -> None:
        self.device = device
        self.session, self.sequence = new_session(), 0
        self.peer, self.highest, self._seen = 0, 0, 0
        self._retired: deque[int] = deque(maxlen=8)

    def header(self, kind: int, slot: int = 0) -> Header:
        """Of the next packet to the other end."""
        if self.sequence == LAST_SEQUENCE:
            self.session, self.sequence = new_session(), 0
        self.sequence += 1
        return Header(kind, self.device, self.session, self.sequence, self.peer, self.highest, slot)

    def hello(self, heard: Header) -> Header:
        """Of a packet that tells the sender of ``heard``, whom :meth:`accept` has refused, this end's session."""
        return self.header(HELLO)._replace(peer=heard.session, echo=heard.sequence)

    def accept(self, header: Header) -> None:
        """Takes note of an authentic packet.

        Raises:
            Dropped: "session" where it is meant for another session of this end or comes from an earlier one of the
                other, "stale" where it answers nothing recent, "replayed" where it came before.
        """
        if header.peer != self.session or header.session in self._retired:
            raise Dropped("session")
        if not 0 <= self.sequence - header.echo < WINDOW:
            raise Dropped("stale")
        if header.session != self.peer:
            if self.peer:
                self._retired.append(self.peer)
            self.peer, self.highest, self._seen = header.session, header.sequence, 1
            return
        ahead = header.sequence - self.highest
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & 2**WINDOW - 1 if ahead < WINDOW else 1
            self.highest = header.sequence
        elif ahead <= -WINDOW or self._seen >> -ahead & 1:
            raise Dropped("replayed")
        else:
            self._seen |= 1 << -ahead


def new_session() -> int:
    """64 random bits, not all of them 0."""
    return secrets.randbits(64) or 1
