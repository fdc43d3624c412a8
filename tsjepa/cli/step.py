"""``python -m tsjepa.cli.step COMMAND ...``: a command that is started by another one and ends with it.

Its standard input is a pipe that its parent holds open and writes nothing to. However the parent ends, the operating
system closes the pipe, and nobody is left behind who writes the folder that a second start needs.
"""

from __future__ import annotations

import os
import sys
import threading

from tsjepa.cli.command_line import main


def end_with_parent() -> None:
    """Ends this process as soon as its standard input is closed."""

    def watch() -> None:
        while os.read(0, 1):
            pass
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    os.setpgrp()  # what a terminal sends reaches the parent alone, which passes it on once
    end_with_parent()
    sys.exit(main())
