"""How a process of this room ends: on a signal, after its work, with a report."""

from __future__ import annotations

import asyncio
import signal
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path

from tsjepa.support.files import write_json

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run_until_stopped(work: Callable[[asyncio.Event], Awaitable[None]]) -> None:
    """Runs ``work``, whose event is set by the first SIGINT or SIGTERM; it then ends by itself."""

    async def main() -> None:
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        for number in SIGNALS:
            loop.add_signal_handler(number, stop.set)
        await work(stop)

    asyncio.run(main())


def check_report(path: str | None) -> None:
    """Makes the folder of a report before the run.

    Raises:
        OSError: the report could not be written there.
    """
    if path is None:
        return
    if Path(path).is_dir():
        raise IsADirectoryError(f"report {path} is a folder: name a JSON file in it.")
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=Path(path).parent):
            pass
    except OSError as error:
        raise OSError(
            f"The report {path} cannot be written ({error.strerror}): choose a folder that you may write to."
        ) from error


def write_report(path: str | None, report: dict) -> None:
    """Writes what happened as JSON, so that a reader finds all of it or nothing."""
    if path is None:
        return
    write_json(path, report)


def stages_line(stages: dict[str, dict[str, float]]) -> str:
    """Median and 99 % of every stage in one line."""
    parts = (f"{name} {stage['p50_ms']:.2f} / {stage['p99_ms']:.2f}" for name, stage in stages.items())
    return f"ms at 50 / 99 %: {', '.join(parts)}."
