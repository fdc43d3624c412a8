"""How a process of this room ends: on a signal, after its work, with a report."""

from __future__ import annotations

import asyncio
import signal
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


def write_report(path: str | None, report: dict) -> None:
    """Writes what happened as JSON, so that a reader finds all of it or nothing."""
    if path is None:
        return
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_json(path, report)


def stages_line(stages: dict[str, dict[str, float]]) -> str:
    """Median and 99 % of every stage in one line."""
    parts = (f"{name} {stage['p50_ms']:.2f} / {stage['p99_ms']:.2f}" for name, stage in stages.items())
    return f"ms at 50 / 99 %: {', '.join(parts)}."
