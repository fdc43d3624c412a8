"""Runs the points of a sweep one after the other, over processes, or over the machines of a Ray cluster."""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator

from tsjepa.support.workers import RAY, run_items

LAUNCHERS = ("serial", "processes", "ray")

Outcome = tuple[list[dict], float]


def evaluate(job: tuple[str, dict]) -> Outcome:
    """Rows of a point, given the name of its module, and the seconds it took.

    On one thread: the number of threads changes the last digits, and then a closed loop.
    """
    import torch

    module, point = job
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    started = time.perf_counter()
    try:
        return importlib.import_module(module).evaluate(point), time.perf_counter() - started
    finally:
        torch.set_num_threads(threads)


def launch(module: str, points: list[dict], launcher: str, workers: int) -> Iterator[tuple[int, Outcome]]:
    """Evaluates ``points`` with ``module.evaluate``; yields (index, outcome) as they are done, in any order.

    Args:
        module: full name of a figure's module.
        points: of its sweep.
        launcher: "serial", "processes" or "ray".
        workers: processes at a time; Ray counts its own machines.

    Raises:
        ValueError: no such launcher.
    """
    if launcher not in LAUNCHERS:
        raise ValueError(f"There is no launcher {launcher!r}; choose from {', '.join(LAUNCHERS)}.")
    jobs = [(module, point) for point in points]
    return run_items(evaluate, jobs, {"serial": 1, "processes": workers, "ray": RAY}[launcher])
