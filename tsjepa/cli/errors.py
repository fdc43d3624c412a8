"""Tells the user's mistakes from the program's, and says them in one sentence."""

from __future__ import annotations

import linecache
import re
from pathlib import Path
from types import TracebackType

from tsjepa.support.recipes import failed_in_own_code, one_sentence

_PACKAGE = Path(__file__).parent.parent
# Modules of others that check what a recipe sets: a learning rate, an accelerator, a number of devices.
_CHECK_SETTINGS = ("torch.optim", "lightning.pytorch.trainer.connectors", "lightning.fabric.utilities.device_parser")

_PLACE = re.compile(r'^  File "(.+)", line (\d+)', flags=re.MULTILINE)


def explain(error: BaseException) -> str | None:
    """Say in one sentence what went wrong, where that is for the user to mend.

    That is so for an exception that this package raises itself (a ``raise`` statement in its code), for a file that
    cannot be opened, for a setting that Lightning, torch or jsonargparse refuses, for a package not installed, and for
    code of the user's own that fails while it is imported or built.

    Returns:
        The sentence, or None for an exception nobody foresaw, which deserves its traceback.
    """
    if _is_raised_here(error) or isinstance(error, OSError):
        # the text of a KeyError is the repr of its message
        return " ".join(str(error.args[0] if isinstance(error, KeyError) else error).split())
    if failed := failed_in_own_code(error):
        return failed
    if isinstance(error, ModuleNotFoundError) and not (error.name or "").startswith("tsjepa"):
        return f"the package {error.name} is not installed; `make setup` installs all that this program needs."
    if isinstance(error, UnicodeDecodeError):
        return f"a file that was to be read is no text in UTF-8 ({error.reason} {error.object[error.start]:#04x})."
    refused_setting = isinstance(error, ValueError) and _module_of(error).startswith(_CHECK_SETTINGS)
    if refused_setting or type(error).__name__ == "MisconfigurationException":
        return " ".join(str(error).split())
    if _module_of(error).startswith("jsonargparse"):
        # The exception of a constructor, caught while jsonargparse tried out the types that an option may have.
        cause = error.__cause__ or error.__context__
        return explain(cause) if cause is not None else one_sentence(str(error))
    return None


def exit_status(error: BaseException) -> int:
    """2 where the command asks for something that there is not or that cannot be; 1 where something failed on the way,
    such as a full disk, a missing package or a loss that explodes."""
    wrong_values = (ValueError, TypeError, LookupError)
    wrong_paths = (FileNotFoundError, FileExistsError, NotADirectoryError, IsADirectoryError)
    refused = isinstance(error, (*wrong_values, *wrong_paths)) or type(error).__name__ == "MisconfigurationException"
    return 2 if refused or _module_of(error).startswith("jsonargparse") else 1


def _innermost_frame(error: BaseException) -> TracebackType | None:
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    return frame


def _module_of(error: BaseException) -> str:
    frame = _innermost_frame(error)
    return frame.tb_frame.f_globals.get("__name__", "") if frame else ""


def _is_raised_here(error: BaseException) -> bool:
    """Whether a ``raise`` statement of this package threw the exception (and not a call that its code made)."""
    file, line = _place_of(error)
    return _PACKAGE in Path(file).parents and linecache.getline(file, line).lstrip().startswith("raise ")


def _place_of(error: BaseException) -> tuple[str, int]:
    """File and line that threw the exception; a worker process sends its frames as the text of a cause."""
    if type(error.__cause__).__name__ == "_RemoteTraceback" and (places := _PLACE.findall(str(error.__cause__))):
        return places[-1][0], int(places[-1][1])
    frame = _innermost_frame(error)
    return (frame.tb_frame.f_code.co_filename, frame.tb_lineno) if frame else ("", 0)
