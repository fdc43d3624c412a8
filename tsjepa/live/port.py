"""A UDP socket in the event loop: what has come is read in one go, and nothing is stored."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable

from tsjepa.live.packet import LARGEST, Dropped

BURST = 256  # datagrams read before others have their turn
BUFFER = 1 << 22  # bytes that the kernel is asked to hold, for bursts while a graph runs
DROPS = (
    *("size", "version", "kind", "device", "forged", "session", "stale", "replayed"),
    *("shape", "range", "overtaken", "unsendable"),
)

Address = tuple
Handle = Callable[[bytes, Address], None]


class Port:
    """Calls ``handle`` with every datagram and its sender's address, and counts those that it refuses.

    Args:
        handle: raises :class:`tsjepa.live.packet.Dropped` for what it does not take.
        bind: host and port to listen at; port 0 for any.
        connect: host and port of the only end that is heard.
        after: called when the datagrams that were waiting have been handled.

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
        family, _, _, _, address = socket.getaddrinfo(*(bind or connect), type=socket.SOCK_DGRAM)[0]
        self.handle, self.after = handle, after
        self.drops: Counter[str] = Counter(dict.fromkeys(DROPS, 0))
        self.received = 0
        self._buffer = bytearray(LARGEST + 1)  # one more, by which one that is too large is known
        self.socket = socket.socket(family, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            self.socket.setsockopt(socket.SOL_SOCKET, option, BUFFER)
        (self.socket.bind if bind else self.socket.connect)(address)

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
            except OSError:  # the other end's machine says that nobody listens there
                continue
            self.received += 1
            try:
                self.handle(bytes(self._buffer[:size]), address)
            except Dropped as drop:
                self.drops[drop.args[0]] += 1
        self.after()

    def send(self, data: bytes, address: Address | None = None) -> None:
        """Sends a datagram, to ``address`` or to the end it is connected to; one that cannot leave is counted."""
        try:
            if address is None:
                self.socket.send(data)
            else:
                self.socket.sendto(data, address)
        except OSError:
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
