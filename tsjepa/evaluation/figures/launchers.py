"""Runs the points of a sweep one after the other, over processes, or over the machines of a Ray cluster."""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

LAUNCHERS = ("serial", "processes", "ray")
LOST_POOLS = 3  # workers that may be killed, one after the other, before the sweep gives up

Outcome = tuple[list[dict], float]


def evaluate(module: str, point: dict) -> Outcome:
    """Rows of a point and the seconds it took, on one thread: the number of threads changes the last digits."""
    import torch

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
        workers: how many at a time; Ray counts its own machines.

    Raises:
        ValueError: no such launcher.
        BrokenProcessPool: workers were killed again and again.
    """
    if launcher not in LAUNCHERS:
        raise ValueError(f"There is no launcher {launcher!r}; choose from {', '.join(LAUNCHERS)}.")
    return {"serial": _serial, "processes": _processes, "ray": _ray}[launcher](module, points, workers)


def _serial(module: str, points: list[dict], workers: int) -> Iterator[tuple[int, Outcome]]:
    for index, point in enumerate(points):
        yield index, evaluate(module, point)


def _processes(module: str, points: list[dict], workers: int) -> Iterator[tuple[int, Outcome]]:
    left, lost = set(range(len(points))), 0
    while left:
        # spawned, because a forked child would share the GL context
        pool = ProcessPoolExecutor(min(workers, len(left)), mp_context=get_context("spawn"))
        try:
            futures = {pool.submit(evaluate, module, points[index]): index for index in sorted(left)}
            for future in as_completed(futures):
                yield futures[future], future.result()
                left.remove(futures[future])
        except BrokenProcessPool:
            # a worker was killed: what it did is done again by a new pool
            lost += 1
            if lost > LOST_POOLS:
                raise
        finally:
            pool.shutdown(cancel_futures=True)


def _ray(module: str, points: list[dict], workers: int) -> Iterator[tuple[int, Outcome]]:
    import ray

    ray.init(ignore_reinit_error=True, log_to_driver=False)
    remote = ray.remote(num_cpus=1)(evaluate)
    futures = {remote.remote(module, point): index for index, point in enumerate(points)}
    while futures:
        (done,), _ = ray.wait(list(futures), num_returns=1)
        yield futures.pop(done), ray.get(done)
