"""Items of work that kill their worker; in a module of their own, which a fresh process imports in no time."""

import os
import signal
from pathlib import Path


def die_once(path: str) -> str:
    """The name of ``path``; kills its process once where that is 2."""
    marker = Path(path)
    if marker.name == "2" and not marker.exists():
        marker.touch()
        die(path)
    return marker.name


def die(item: object) -> None:
    """Kills its process."""
    os.kill(os.getpid(), signal.SIGKILL)
