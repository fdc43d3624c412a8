"""What reading files of others needs: optional packages, pointers in place of data, exceptions of any library."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

POINTER = b"version https://git-lfs.github.com/spec/"


def optional(module: str, what: str = "This recording", extra: str = "data") -> ModuleType:
    """A module of an optional group of packages.

    Args:
        module: to import.
        what: needs it, as the sentence begins.
        extra: the group that has it.

    Raises:
        ModuleNotFoundError: with the sentence that says what to install.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        package = module.split(".")[0]
        raise ModuleNotFoundError(
            f"{what} needs the package {package}: install it with `pip install 'tsjepa[{extra}]'`."
        ) from error


def reason(error: BaseException) -> str:
    """One line for an exception of a library or of this package."""
    text = " ".join(str(error.args[0] if isinstance(error, KeyError) and error.args else error).split())
    text = text.rstrip(".")
    if isinstance(error, ValueError) and text:
        return text + "."
    return f"{type(error).__name__}: {text}." if text else f"{type(error).__name__}."


def is_pointer(path: Path) -> bool:
    """Whether the file is a Git LFS pointer, that is a few lines of text in place of the data."""
    with path.open("rb") as file:
        return file.read(len(POINTER)) == POINTER


def refuse_pointer(path: Path) -> None:
    """Raises ValueError where the file is a Git LFS pointer."""
    if is_pointer(path):
        raise ValueError(f"{path.name} is a Git LFS pointer, not the data: run `git lfs pull` in its repository.")


def refuse_pointers(files: Sequence[Path]) -> None:
    """Raises ValueError where every one of ``files`` is a Git LFS pointer."""
    if files and all(is_pointer(file) for file in files):
        raise ValueError(
            f"{files[0].name} is a Git LFS pointer, not the data, and so are all {len(files)} files of its kind: run "
            "`git lfs pull` in their repository."
        )
