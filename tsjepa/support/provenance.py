"""Where a result file comes from, written into the file itself."""

from __future__ import annotations

import hashlib
import inspect
import os
import shlex
import subprocess
import sys
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tsjepa.support.precision import LIMITS
from tsjepa.support.processor import cores, cpu_flags, processor

# what decides the figures; results lie elsewhere and change while they are made
CODE = ("tsjepa", "recipes", "pyproject.toml")


def provenance() -> dict[str, str]:
    """The command line, the commit (the version where there is no checkout) and the date of this run.

    The commit ends in "-dirty" where the code that runs is not the code that was committed.
    """
    return {
        "command": shlex.join([*program(), *sys.argv[1:]]),
        "commit": commit_of(Path(__file__).parent) or f"version {version('tsjepa')}",
        "date": datetime.now(timezone.utc).date().isoformat(),
    }


def program() -> list[str]:
    """The words that start this program again; its own command line has a name."""
    started_as_module = sys.modules["__main__"].__spec__
    if started_as_module is None:
        return [Path(sys.argv[0]).name]
    module = started_as_module.name
    return ["tsjepa"] if module.startswith("tsjepa.cli.") else ["python", "-m", module]


def machine() -> dict[str, str | int]:
    """Processor, the cores that this process may use, the instruction sets, and what the environment limits them to."""
    limits = {name: os.environ[name] for name in LIMITS if name in os.environ}
    return {"processor": processor(), "cores": cores(), "flags": " ".join(cpu_flags()), **limits}


def commit_of(folder: Path) -> str | None:
    """Ten characters of the commit of the checkout that holds ``folder``, with "-dirty" where its code has changed.

    None where there is no checkout.
    """
    commit = _git(folder, "describe", "--always", "--abbrev=10", "--exclude=*")
    changes = _git(folder, "status", "--porcelain", "--", *(f":/{part}" for part in CODE))
    return f"{commit}-dirty" if commit and changes else commit


def code_hash(*others: Any) -> str:
    """SHA-256 over this package's source files and those of ``others``: modules, functions, classes or instances.

    Unlike a commit it also tells two states of a checkout apart that nobody has committed. Code without a file, typed
    into an interpreter, counts as another one every time.
    """
    package = Path(__file__).parent.parent
    sources = [_source(other) for other in others]
    files = {*package.rglob("*.py"), *(source for source in sources if source is not None)}
    digest = hashlib.sha256(os.urandom(16) if None in sources else b"")
    for file in sorted(files):
        content = file.read_bytes()
        digest.update(
            f"{file.relative_to(package) if file.is_relative_to(package) else file.name} {len(content)} ".encode()
        )
        digest.update(content)
    return digest.hexdigest()


def _source(other: Any) -> Path | None:
    """The file of a module, or that defines a function, a class or that of an instance; None where there is none."""
    has_file = inspect.ismodule(other) or inspect.isroutine(other) or inspect.isclass(other)
    try:
        file = Path(inspect.getfile(other if has_file else type(other)))
    except (TypeError, OSError):  # of a class that was typed in
        return None
    return file if file.is_file() else None


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        # without the lock, which a commit that somebody makes meanwhile needs
        command = ["git", "--no-optional-locks", *arguments]
        answer = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout.strip()
