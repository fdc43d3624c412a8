"""Items of work over processes of this machine, or over the machines of a Ray cluster."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from queue import SimpleQueue
from typing import Any, Final, Literal

from tsjepa.support.checks import at_least
from tsjepa.support.trust import trusting_as_here

RAY: Final = "ray"
ATTEMPTS = 3  # at an item whose worker is killed
QUEUED = 2  # items in flight per worker: the results of more would only fill the memory

Workers = int | Literal["ray"]


def run_items(function: Callable[[Any], Any], items: Iterable[Any], workers: Workers = 1) -> Iterator[tuple[int, Any]]:
    """Calls ``function`` on every item and yields (index of the item, result) as they are done, in any order.

    A worker that is killed costs the item that it had: another one tries it again.

    Args:
        function: of a module, so that another process finds it by name.
        items: what it is called with; items and results travel between processes.
        workers: 1 for this process, more for processes of their own, or "ray" for a Ray cluster: the one that the
            environment variable RAY_ADDRESS names, else one on all cores of this machine.

    Raises:
        ValueError: fewer than one worker.
        RuntimeError: an item's workers were killed again and again.
    """
    function = trusting_as_here(function)
    if workers == RAY:
        yield from _over_ray(function, items)
        return
    at_least(1, workers=int(workers))
    if workers == 1:
        yield from ((index, function(item)) for index, item in enumerate(items))
    else:
        yield from _over_processes(function, items, int(workers))


def _over_processes(function: Callable, items: Iterable, workers: int) -> Iterator[tuple[int, Any]]:
    # every worker is a pool of its own, because a killed process takes its whole pool down
    idle: SimpleQueue[ProcessPoolExecutor] = SimpleQueue()
    for _ in range(workers):
        idle.put(_one_worker())

    def run(index: int, item: Any) -> tuple[int, Any]:
        worker = idle.get()
        try:
            for _ in range(ATTEMPTS):
                try:
                    return index, worker.submit(function, item).result()
                except BrokenProcessPool:
                    worker.shutdown(wait=False)
                    worker = _one_worker()
        finally:
            idle.put(worker)
        raise RuntimeError(f"The workers of item {index} were killed {ATTEMPTS} times; is there enough memory?")

    waiting, pending = enumerate(items), set[Future]()
    threads = ThreadPoolExecutor(workers)
    try:
        while True:
            pending |= {threads.submit(run, *item) for item in islice(waiting, QUEUED * workers - len(pending))}
            if not pending:
                break
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    finally:
        threads.shutdown(cancel_futures=True)
        while not idle.empty():
            idle.get().shutdown()


def _one_worker() -> ProcessPoolExecutor:
    # spawned: a forked process would share the GL context
    return ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_die_with_parent)


def _die_with_parent() -> None:
    """A worker whose parent was killed would wait for items for ever."""

    def watch() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _over_ray(function: Callable, items: Iterable) -> Iterator[tuple[int, Any]]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray would report to its makers
    import ray

    if not ray.is_initialized():
        ray.init(log_to_driver=False)
    remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(function)
    most = QUEUED * max(1, int(ray.cluster_resources().get("CPU", 1)))
    waiting, pending = enumerate(items), dict[Any, int]()
    while True:
        for index, item in islice(waiting, most - len(pending)):
            pending[remote.remote(item)] = index
        if not pending:
            break
        (done,), _ = ray.wait(list(pending), num_returns=1)
        yield pending.pop(done), ray.get(done)
