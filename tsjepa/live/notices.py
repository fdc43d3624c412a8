"""What a process says while it runs, where something fails or nothing comes."""

from __future__ import annotations

import sys
from contextlib import suppress


def tell(process: str, sentence: str) -> None:
    """Prints a line of the "device" or the "controller" on stderr; where nobody can read it the loop goes on."""
    with suppress(OSError):
        print(f"tsjepa {process}: {' '.join(sentence.split())}", file=sys.stderr)
