"""What a file may make this program do: use the classes below and read tensors, unless the user writes ``--trust``.

A recipe names classes by their import path, and a checkpoint is a pickle. Both may come from somebody else, and neither
may decide on its own what is imported, called or unpickled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

TRUST = "--trust"
# What a recipe may name. Only constructors of the type that an option asks for are ever called.
PACKAGES = ("tsjepa", "lightning", "torch", "torchrl", "tensordict")


def restrict_recipes() -> None:
    """Refuses recipes that name anything outside :data:`PACKAGES`, for the rest of this process."""
    from jsonargparse import set_parsing_settings

    set_parsing_settings(
        # an option without a type would build whatever class it is given
        instantiate_subclass_spec_in_any=False,
        import_path_denylist=["*"],
        import_path_allowlist=list(PACKAGES),
    )


def load_checkpoint(path: str, map_location: Any = None, trusted: bool = False) -> dict[str, Any]:
    """Reads a checkpoint of Lightning's: tensors and plain values; anything else only if it is ``trusted``.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is damaged, or holds what would have to be unpickled.
    """
    import pickle

    import torch

    with open(path, "rb") as file:
        try:
            return torch.load(file, map_location=map_location, weights_only=not trusted)
        except pickle.UnpicklingError as error:
            if trusted:
                raise ValueError(f"The checkpoint {path} is damaged; take another one or start anew.") from error
            raise ValueError(
                f"The checkpoint {path} holds more than tensors and plain values, and reading the rest could run any "
                f"program: if you made it yourself, add {TRUST}; if it is damaged, take another one."
            ) from error
        except (RuntimeError, EOFError, OSError, KeyError) as error:
            raise ValueError(f"The checkpoint {path} is damaged; take another one or start anew.") from error


_trusted = False


@contextmanager
def everything_trusted() -> Iterator[None]:
    """Lets the entries that are loaded meanwhile name classes of any package: the user wrote ``--trust``."""
    global _trusted
    before, _trusted = _trusted, True
    try:
        yield
    finally:
        _trusted = before


def may_import(path: str, trusted: bool = False) -> bool:
    """Whether an entry may name the class ``path``: one of this package's own, or any where the user trusts it."""
    return trusted or _trusted or path.startswith("tsjepa.")


def trusting_as_here(function: Callable) -> Callable:
    """``function`` for another process, in which it may import what it may import in this one."""
    return partial(_trusting, function) if _trusted else function


def _trusting(function: Callable, *arguments: Any) -> Any:
    with everything_trusted():
        return function(*arguments)
