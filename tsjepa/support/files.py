"""Writing so that a reader finds the old content or the new, never half of it, and one process at a time writes."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux's fcntl.h


def write_text(path: str | Path, text: str) -> None:
    """Writes ``text`` beside ``path`` and renames it into place."""
    path = Path(path)
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text)
    os.replace(partial, path)


def replace_folder(partial: Path, folder: Path) -> None:
    """Renames ``partial`` to ``folder`` and removes what was there before.

    On Linux the two change places in one system call, so a reader always finds one of them. Elsewhere, or on a file
    system that cannot, there is none for the moment between two renames.
    """
    if folder.exists():
        old = partial if _exchange(partial, folder) else _retire(partial, folder)
        shutil.rmtree(old)
    else:
        os.replace(partial, folder)


def _exchange(first: Path, second: Path) -> bool:
    if sys.platform != "linux":
        return False
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    names = os.fsencode(first), os.fsencode(second)
    return rename is not None and rename(AT_FDCWD, names[0], AT_FDCWD, names[1], RENAME_EXCHANGE) == 0


def _retire(partial: Path, folder: Path) -> Path:
    retired = folder.with_name(folder.name + ".retired")
    shutil.rmtree(retired, ignore_errors=True)
    os.replace(folder, retired)
    os.replace(partial, folder)
    return retired


@contextmanager
def exclusive(folder: str | Path) -> Iterator[None]:
    """Keeps other processes from writing ``folder``; the operating system frees it when this process ends or dies.

    Raises:
        FileExistsError: another process is writing it.
    """
    from filelock import FileLock, Timeout

    folder = Path(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder.with_name(f".{folder.name}.lock"))
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise FileExistsError(
            f"Another process is writing {folder}: wait until it is done, or choose another folder."
        ) from error
    try:
        yield
    finally:
        Path(lock.lock_file).unlink(missing_ok=True)  # while it is held: nobody else's can be taken away
        lock.release()
