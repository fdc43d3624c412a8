"""The fleet in a process of its own and in real time, so that no browser slows the machines."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.connection import Connection

import torch

from tsjepa.evaluation.rollouts import Loop
from tsjepa.evaluation.simulate import load_controller
from tsjepa.support.trust import trusting_as_here
from tsjepa.watch.fleet import RunningFleet
from tsjepa.watch.setting import Setting, Snapshot

Ask = Callable[[Setting, Sequence[int]], Snapshot]
"""From where the sliders stand, and the devices that were pushed, to how the fleet is."""

FORGIVEN_S = 0.1  # of delay that is caught up; what is later than that stays late
PACE_S = 2.0  # over which the pace is taken


class Clock:
    """Begins slots at the rate of the wall clock, without drift.

    Args:
        slot: seconds.
    """

    def __init__(self, slot: float) -> None:
        self.slot, self.due = slot, time.monotonic() + slot
        self.begun: deque[float] = deque(maxlen=max(2, round(PACE_S / slot)))

    def wait(self) -> None:
        """Sleeps until the next slot is due."""
        now = time.monotonic()
        if now < self.due:
            time.sleep(self.due - now)
        self.begun.append(max(now, self.due))
        self.due = max(self.due, now - FORGIVEN_S) + self.slot

    def pace(self) -> float:
        """Seconds of slots in a second of the wall clock; 1 before there is anything to measure."""
        if len(self.begun) < 2:
            return 1.0
        return (len(self.begun) - 1) * self.slot / (self.begun[-1] - self.begun[0])


@contextmanager
def running(loop: Loop, controller: str, setting: Setting, seed: int) -> Iterator[Ask]:
    """Runs the fleet in real time until the block is left.

    Args:
        loop: what no slider sets.
        controller: the name of the loop's controller, which the other process loads for itself.
        setting: where the sliders stand at first.
        seed: see :class:`tsjepa.watch.fleet.RunningFleet`.

    Yields:
        A function that may be called by one thread at a time. It raises the ValueError that has ended the
        fleet, such as that of a scheduler of the user's own, or EOFError when the process has ended otherwise.
    """
    context = multiprocessing.get_context("spawn")  # an OpenGL context does not survive a fork
    here, there = context.Pipe()
    arguments = (there, replace(loop, controller=controller), setting, seed)
    process = context.Process(target=trusting_as_here(serve), args=arguments, daemon=True, name="tsjepa-fleet")
    process.start()
    there.close()

    def ask(setting: Setting, pushed: Sequence[int]) -> Snapshot:
        # of a process that has ended the reason is still to be read
        with suppress(BrokenPipeError, ConnectionResetError):
            here.send((setting, list(pushed)))
        answer = here.recv()
        if isinstance(answer, Exception):
            raise answer
        return answer

    try:
        yield ask
    finally:
        here.close()
        process.join()


def serve(connection: Connection, loop: Loop, setting: Setting, seed: int) -> None:
    """Runs slots in real time, and between two of them answers the other end until it closes.

    Args:
        connection: receives (setting, pushed devices) and sends a :class:`tsjepa.watch.setting.Snapshot`, or the
            ValueError that has ended the fleet.
        loop, setting, seed: as of :func:`running`; the loop's controller is a name.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page, which closes the connection
    torch.set_num_threads(1)  # the other core is the page's
    fleet = RunningFleet(replace(loop, controller=load_controller(loop.controller)), setting, seed)
    clock = Clock(loop.plant.spec.slot)
    try:
        while True:
            if connection.poll():
                wanted, pushed = connection.recv()
                fleet.change(wanted)
                for device in pushed:
                    fleet.push(device)
                connection.send(fleet.snapshot(clock.pace()))
            fleet.slot()
            clock.wait()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except ValueError as error:
        connection.send(error)
        if os.environ.get("TSJEPA_TRACEBACK") == "1":
            raise
