"""Where a result file comes from, written into the file itself."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path


def provenance() -> dict[str, str]:
    """The command line, the commit (the version where there is no checkout) and the date of this run."""
    started_as_module = sys.modules["__main__"].__spec__
    program = f"python -m {started_as_module.name}" if started_as_module else Path(sys.argv[0]).name
    return {
        "command": " ".join([program, *sys.argv[1:]]),
        "commit": _commit() or f"version {version('tsjepa')}",
        "date": datetime.now(timezone.utc).date().isoformat(),
    }


def machine() -> dict[str, str | int]:
    """Processor, and its number of cores here."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        name = platform.processor() or platform.machine()
    return {"processor": name, "cores": os.cpu_count() or 1}


def _commit() -> str | None:
    try:
        answer = subprocess.run(
            ["git", "describe", "--always", "--abbrev=10", "--exclude=*"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout.strip()
