"""Writing so that a reader finds the old content or the new, never half of it, and one process at a time writes."""

from __future__ import annotations

import ctypes
import json
import math
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

AT_FDCWD, RENAME_EXCHANGE = -100, 2  # of Linux's fcntl.h


@contextmanager
def whole(path: str | Path, suffix: str = "") -> Iterator[Path]:
    """Gives the name beside ``path`` to write to, which is renamed into place when the block is left.

    Args:
        path: of the file.
        suffix: that the name ends in, for a writer that chooses the format by it.

    Raises:
        OSError: the file could not be written, of which nothing is left; what was there stays.
    """
    path = Path(path)
    partial = path.with_name(f"{path.name}.partial{suffix}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)  # a full disk's does not say which file
        raise
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Writes ``text`` as :func:`whole` does."""
    with whole(path) as partial:
        partial.write_text(text)


def read_json(path: str | Path) -> dict[str, Any]:
    """The JSON object in ``path``.

    Raises:
        ValueError: the file holds something else.
    """
    try:
        value = json.loads(Path(path).read_text())
    except ValueError as error:
        raise ValueError(f"{path} is damaged: it is no JSON ({error}); make it anew.") from error
    if not isinstance(value, dict):
        raise ValueError(f"{path} is damaged: it holds no JSON object; make it anew.")
    return value


def write_json(path: str | Path, value: Any, indent: int = 2) -> None:
    """Writes ``value`` as :func:`write_text` does.

    Raises:
        ValueError: a number in it is not finite; what was there stays.
    """
    write_text(path, json_text(path, value, indent) + "\n")


def json_text(path: str | Path, value: Any, indent: int | None = None) -> str:
    """``value`` as the JSON that ``path`` is to hold. JSON has no NaN, and many readers refuse it.

    Raises:
        ValueError: naming the first number that is not finite.
    """
    where = _not_finite(value)
    if where is not None:
        raise ValueError(f"{path} is not written: {where} in it is not finite, so that the result means nothing.")
    return json.dumps(value, indent=indent, allow_nan=False)


def _not_finite(value: Any, name: str = "result") -> str | None:
    """The place of the first number that is NaN or infinite."""
    if isinstance(value, float):
        return None if math.isfinite(value) else name
    if isinstance(value, dict):
        parts = ((f"{name}.{key}", item) for key, item in value.items())
    elif isinstance(value, (list, tuple)):
        parts = ((f"{name}[{index}]", item) for index, item in enumerate(value))
    else:
        return None
    return next((found for place, item in parts if (found := _not_finite(item, place)) is not None), None)


def refuse_to_replace(folder: Path, what: str, *marks: str) -> None:
    """Lets only a folder be replaced that is empty or holds ``what``, which one of the files ``marks`` tells.

    Raises:
        FileExistsError: it holds something else, or is a file.
    """
    if folder.is_dir():
        other = any(folder.iterdir()) and not any((folder / mark).is_file() for mark in marks)
    else:
        other = folder.exists()
    if other:
        raise FileExistsError(f"{folder} is there and is no {what}: choose a folder that may be replaced.")


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
