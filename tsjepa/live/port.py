"""A UDP socket in the event loop: what has come is read in one go, and nothing is stored."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable, Mapping

from tsjepa.live.notices import tell
from tsjepa.live.packet import LARGEST, Dropped

BURST = 256  # datagrams read before others have their turn
BUFFER = 1 << 22  # bytes that the kernel is asked to hold, for bursts while a graph runs
DROPS = {
    "size": "no packet",
    "version": "another version's packet",
    "kind": "another direction's packet",
    "device": "a --number that is not known here",
    "forged": "another --key, or changed on its way",
    "session": "a first hello, or an earlier session",
    "stale": "an answer to nothing recent",
    "replayed": "came before",
    "shape": "another model's graphs",
    "range": "a number out of range",
    "overtaken": "older than the newest",
    "unsendable": "refused by this machine's network",
}
EXPECTED = ("session", "stale", "replayed", "overtaken")  # of these some are dropped where nothing is wrong

Address = tuple
Handle = Callable[[bytes, Address], None]


class Port:
    """Calls ``handle`` with every datagram and its sender's address, and counts those that it refuses.

    Args:
        handle: raises :class:`tsjepa.live.packet.Dropped` for what it does not take.
        bind: host and port to listen at; port 0 for any.
        connect: host and port of the only end that is heard.
        after: called when the datagrams that were waiting have been handled.

    Attributes:
        received, sent: datagrams.
        drops: how many were dropped, by reason.
        trouble: what the network said last, since a datagram was taken; empty for nothing.

    Raises:
        OSError: the address is taken or there is none of that name.
    """

    def __init__(
        self,
        handle: Handle,
        bind: tuple[str, int] | None = None,
        connect: tuple[str, int] | None = None,
        after: Callable[[], None] = lambda: None,
    ) -> None:
        self.handle, self.after = handle, after
        self.drops: Counter[str] = Counter(dict.fromkeys(DROPS, 0))
        self.received = self.sent = 0
        self.trouble, self.process = "", "controller" if bind else "device"
        self._buffer = bytearray(LARGEST + 1)  # one more, by which one that is too large is known
        self.socket = _socket(bind, connect)
        self.socket.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            self.socket.setsockopt(socket.SOL_SOCKET, option, BUFFER)

    @property
    def address(self) -> Address:
        """Where it listens."""
        return self.socket.getsockname()

    def open(self) -> None:
        """Has the running event loop call :meth:`drain` whenever something has come."""
        asyncio.get_running_loop().add_reader(self.socket, self.drain)

    def close(self) -> None:
        """Hears no more."""
        asyncio.get_running_loop().remove_reader(self.socket)
        self.socket.close()

    def drain(self) -> None:
        """Handles what has come."""
        for _ in range(BURST):
            try:
                size, address = self.socket.recvfrom_into(self._buffer)
            except BlockingIOError:
                break
            except OSError as error:  # the other end's machine says that nobody listens there
                self.trouble = str(error.strerror)
                continue
            self.received += 1
            try:
                self.handle(bytes(self._buffer[:size]), address)
                self.trouble = ""
            except Dropped as drop:
                reason = drop.args[0]
                if not self.drops[reason] and reason not in EXPECTED:
                    sender = f"{reason} ({DROPS[reason]}) from {address_text(address)}"
                    tell(self.process, f"a datagram is dropped: {sender}; more of them are only counted.")
                self.drops[reason] += 1
        self.after()

    def send(self, data: bytes, address: Address | None = None) -> None:
        """Sends a datagram, to ``address`` or to the end it is connected to; one that cannot leave is counted."""
        try:
            if address is None:
                self.socket.send(data)
            else:
                self.socket.sendto(data, address)
            self.sent += 1
        except OSError as error:
            self.trouble = str(error.strerror)
            # a controller that is not there yet is no news; see tsjepa.live.silence
            if not self.drops["unsendable"] and not isinstance(error, ConnectionRefusedError):
                tell(self.process, f"a datagram cannot be sent ({self.trouble}); more of them are only counted.")
            self.drops["unsendable"] += 1

    def send_later(self, seconds: float, data: bytes, address: Address | None = None) -> None:
        """Sends a datagram after some time, unless the port is closed by then."""

        def leave() -> None:
            if self.socket.fileno() >= 0:
                self.send(data, address)

        asyncio.get_running_loop().call_later(seconds, leave)


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of ``HOST:PORT``; IPv6 hosts stand in brackets.

    Raises:
        ValueError: it is something else.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise ValueError(f"{text!r} is no address: write HOST:PORT, such as 127.0.0.1:5700.")
    return host.strip("[]"), int(port)


def address_text(address: Address) -> str:
    """``HOST:PORT`` of a host and a port, as :func:`parse_address` reads it."""
    host, port = address[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def dropped_line(drops: Mapping[str, int]) -> str:
    """How many datagrams were dropped, and for which reasons."""
    reasons = ", ".join(f"{count} {reason} ({DROPS[reason]})" for reason, count in drops.items() if count)
    return f"{sum(drops.values())} datagrams dropped{reasons and ': '}{reasons}"


def _socket(bind: tuple[str, int] | None, connect: tuple[str, int] | None) -> socket.socket:
    """A socket that listens at ``bind`` or is connected to ``connect``.

    Raises:
        OSError: as :class:`Port`.
    """
    made = None
    try:
        family, _, _, _, address = socket.getaddrinfo(*(bind or connect), type=socket.SOCK_DGRAM)[0]
        made = socket.socket(family, socket.SOCK_DGRAM)
        (made.bind if bind else made.connect)(address)
    except (OSError, UnicodeError) as error:  # a host's name may have parts that no name has
        if made is not None:
            made.close()
        place, why = address_text(bind or connect), getattr(error, "strerror", None) or error
        if bind:
            raise OSError(
                f"Nothing can listen at {place} ({why}): end what listens there, or give --bind a free port and an "
                "address of this machine."
            ) from error
        raise OSError(f"{place} cannot be reached ({why}): give --controller the controller's HOST:PORT.") from error
    return made
