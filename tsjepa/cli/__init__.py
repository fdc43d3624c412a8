"""The command line: ``tsjepa COMMAND ...``, and ``lightning COMMAND ...`` as another name for the same program."""

from tsjepa.cli.command_line import (
    COMMANDS,
    LIGHTNING_COMMANDS,
    function_of,
    lightning_main,
    main,
    run_command,
)

__all__ = ["COMMANDS", "LIGHTNING_COMMANDS", "function_of", "lightning_main", "main", "run_command"]
