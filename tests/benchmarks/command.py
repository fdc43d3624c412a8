"""Runs a command of the program as a user would, and times it."""

import os
import subprocess
import sys
import time
from pathlib import Path


def seconds_to_run(folder: Path, *words: str, threads: int | None = None) -> float:
    """Wall time of ``tsjepa WORDS`` in ``folder``, the start of Python included.

    Args:
        folder: working directory.
        words: command and options.
        threads: of torch; None for as many as there are cores.

    Raises:
        SystemExit: the command failed; says with what.
    """
    limit = {} if threads is None else {"OMP_NUM_THREADS": str(threads)}
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"} | limit
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "tsjepa.cli", *words], cwd=folder, env=environment, capture_output=True, text=True
    )
    seconds = time.perf_counter() - start
    if done.returncode:
        raise SystemExit(f"tsjepa {' '.join(words)} ended with status {done.returncode}: {done.stderr[-2000:]}")
    return seconds
