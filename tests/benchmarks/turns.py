"""Contenders that take turns, each in a process of its own: GL contexts and trainers do not share one well."""

import multiprocessing
import time
from collections.abc import Callable

STOP_S = 30  # after which a contender that does not end by itself is ended


def serve(connection, build: Callable, arguments: tuple) -> None:
    """Does as many units of work as it is told to, and answers with units per second.

    Args:
        connection: of the pipe to the parent; 0 units ends it.
        build: gives ``make(units) -> units made`` and a dictionary of metadata, which is sent first.
        arguments: of ``build``.
    """
    make, metadata = build(*arguments)
    make(1)
    connection.send(metadata)
    while units := connection.recv():
        start = time.perf_counter()
        made = make(units)
        connection.send(made / (time.perf_counter() - start))


class Contender:
    """A process that works when asked to.

    Args:
        build, arguments: see :func:`serve`, or what another ``target`` takes after the connection.
        target: what runs in the process.

    Raises:
        RuntimeError: the process ended before it was ready, or in :meth:`rate`; its traceback is on stderr.
    """

    def __init__(self, build: Callable, *arguments, target: Callable = serve) -> None:
        context = multiprocessing.get_context("spawn")
        self.name = build.__name__
        self.connection, other = context.Pipe()
        self.process = context.Process(target=target, args=(other, build, arguments), daemon=True)
        self.process.start()
        other.close()
        self.metadata = self._receive()

    def rate(self, units: int) -> float:
        """Units per second of one turn."""
        self.connection.send(units)
        return self._receive()

    def stop(self) -> None:
        self.connection.send(0)
        self.process.join(STOP_S)
        if self.process.is_alive():
            self.process.terminate()
            self.process.join()

    def _receive(self):
        try:
            return self.connection.recv()
        except EOFError:
            self.process.join()
            raise RuntimeError(f"{self.name} ended with status {self.process.exitcode}; see above.") from None
