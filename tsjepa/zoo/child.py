"""A command of the program in a process of its own, which ends when this one does."""

from __future__ import annotations

import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

GRACE = 10.0  # seconds in which a command that is told to stop may end by itself


def run(words: list[str]) -> float:
    """Runs a command of the program; the seconds that it took.

    What the command says goes where this process prints. However this process ends, the command ends with it. Ctrl-C
    and SIGTERM are passed on to the command, which is waited for.

    Args:
        words: of the command, after the program's name.

    Raises:
        RuntimeError: it failed; it has said why.
    """
    print(f"tsjepa {shlex.join(words)}", flush=True)
    began = time.monotonic()
    command = [sys.executable, "-m", "tsjepa.cli.step", *words]
    # the command ends when its standard input is closed, which leaving this block does, and the end of this process
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=output()) as process, sigterm_raises():
        try:
            status = process.wait()
        except BaseException as stopped:
            process.send_signal(signal.SIGINT if isinstance(stopped, KeyboardInterrupt) else signal.SIGTERM)
            stop(process)
            raise
    if status:
        raise RuntimeError(f"`tsjepa {words[0]}` ended with status {status}: mend what it says, and start this again.")
    return time.monotonic() - began


def output() -> int | None:
    """The file to which this process says things, which ``--json`` makes standard error; None where there is none."""
    try:
        return sys.stdout.fileno()
    except (AttributeError, OSError):  # None, or text that is kept in memory
        return None


def stop(process: subprocess.Popen) -> None:
    """Waits for a process that was told to stop, which is ended if it goes on for too long."""
    try:
        process.wait(GRACE)
    except subprocess.TimeoutExpired:
        process.kill()


@contextmanager
def sigterm_raises() -> Iterator[None]:
    """Within, SIGTERM raises SystemExit with the status that a shell gives such an end."""

    def end(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
