"""The command line: ``tsjepa COMMAND ...``, and ``lightning COMMAND ...`` as another name for the same program.

``fit``, ``validate``, ``test`` and ``predict`` are Lightning's; every other command is one typed function, whose
arguments become options. Nothing heavy is imported before the command is known.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext, redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import Any

from tsjepa.cli.afterwards import next_step
from tsjepa.cli.errors import exit_status, explain
from tsjepa.support.files import exclusive
from tsjepa.support.nearest import did_you_mean
from tsjepa.support.recipes import parse_arguments
from tsjepa.support.trust import TRUST, everything_trusted, may_import, restrict_recipes

LIGHTNING_COMMANDS = {
    "fit": "train a model",
    "validate": "evaluate a checkpoint on the validation data",
    "test": "evaluate a checkpoint on the test data",
    "predict": "run a checkpoint on the prediction data",
}
COMMANDS = {
    "collect": ("tsjepa.data.collect:collect", "record a data set of frames and commands from the plant"),
    "inspect": ("tsjepa.data.inspect:inspect_recording", "say what is in a recording or a radio trace of others"),
    "import": ("tsjepa.data.importer:import_recording", "make a data set from a recording of others"),
    "export-data": ("tsjepa.data.exporter:export_data", "write a data set as LeRobot v3.0, losslessly"),
    "trace": (
        "tsjepa.evaluation.trace:trace",
        "import, simulate or draw radio links: tsjepa trace import LOG TABLE.parquet",
    ),
    "evaluate": ("tsjepa.evaluation.evaluate:evaluate", "close the loop on held-out starts and print the table"),
    "simulate": ("tsjepa.evaluation.simulate:simulate", "run a fleet of plants that share a radio"),
    "watch": ("tsjepa.watch.command:watch", "show a running fleet as a web page of this machine"),
    "figures": ("tsjepa.paper.command:figures", "redraw the paper's figures, or run their sweeps"),
    "report": ("tsjepa.paper.report:report", "compare every figure with what the paper claims"),
    "export": ("tsjepa.zoo.export:export", "make a trained model an entry of the zoo"),
    "deploy": ("tsjepa.zoo.deploy:deploy", "write a model as ONNX or torch.export graphs"),
    "device": ("tsjepa.live.device:device", "watch a machine, send embeddings by UDP, apply the commands that come"),
    "controller": ("tsjepa.live.controller:controller", "control many devices by UDP"),
    "zoo": (
        "tsjepa.zoo.verify:zoo",
        "list the pretrained models, verify them, or train one: tsjepa zoo train NAME",
    ),
    "doctor": ("tsjepa.cli.doctor:doctor", "tell what this machine offers and what to mend"),
    "completion": ("tsjepa.cli.completion:completion", "print a script that completes commands and options in a shell"),
}
JSON = "--json"
FIRST_STEPS = """Control machines from pixels over a radio that cannot carry video. Three commands to start with:

  {program} doctor                                what this machine offers, and how long training takes on it
  {program} simulate --config recipes/demo.yaml   a pretrained model controls cart-poles over a lossy radio
  {program} zoo                                   the pretrained models and their scores

{program} --help lists all commands."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    What the user got wrong is answered in one sentence, without a traceback unless ``TSJEPA_TRACEBACK=1``; anything
    unforeseen keeps its traceback.

    Args:
        arguments: The command and its options; those of the process when None.

    Returns:
        The exit status: 0; 2 when the command asks for what there is not or what cannot be; 1 when it failed on the way
        for another reason that the user can mend; 130 after Ctrl-C.

    Raises:
        SystemExit: 2 when an option is wrong, 0 after the ``--help`` of a command.
    """
    program = "lightning" if Path(sys.argv[0]).name == "lightning" else "tsjepa"
    command, *options = (sys.argv[1:] if arguments is None else list(arguments)) or [""]
    trusted, as_json = TRUST in options, JSON in options
    options = [option for option in options if option not in (TRUST, JSON)]
    known = [*LIGHTNING_COMMANDS, *COMMANDS]
    try:
        if command == "":
            print(FIRST_STEPS.format(program=program))
        elif command in ("-h", "--help"):
            print(_help(program), flush=True)
        elif command == "--version":
            print(f"tsjepa {importlib.metadata.version('tsjepa')}")
        elif command in known:
            if not trusted:
                restrict_recipes()
            with everything_trusted() if trusted else nullcontext():
                return _answer(command, options, program, trusted, as_json)
        else:
            meant = did_you_mean(command, known)
            print(f"{program}: there is no command '{command}'{meant} (commands: {program} --help)", file=sys.stderr)
            return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of a pipe (`| head`) has gone; without this Python would complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        sentence = explain(error)
        if sentence is None or os.environ.get("TSJEPA_TRACEBACK") == "1":
            raise
        print(f"{program} {command}: {sentence}", file=sys.stderr)
        return exit_status(error)
    return 0


# One program under two names.
lightning_main = main


def _answer(command: str, options: list[str], program: str, trusted: bool, as_json: bool) -> int:
    """Runs a command, and says what to do next or prints its result as JSON; the exit status."""
    # what is said on the way would spoil the JSON
    with redirect_stdout(sys.stderr) if as_json else nullcontext():
        if command in LIGHTNING_COMMANDS:
            from tsjepa.training.run import run_lightning

            values, result = {}, run_lightning(command, options, program, trusted)
        else:
            values, result = run_command(command, options, program)
    if as_json:
        print(json.dumps({"path": str(result)} if isinstance(result, Path) else result, indent=2))
    elif (step := next_step(command, values, result, options)) is not None:
        print(f"Next, {step}{' --trust' * trusted}")
    return 1 if command == "doctor" and (result or {}).get("mend") else 0


def _help(program: str) -> str:
    commands = {**LIGHTNING_COMMANDS, **{name: summary for name, (_, summary) in COMMANDS.items()}}
    return "\n".join(
        [
            f"usage: {program} COMMAND [--config RECIPE.yaml] [options]",
            "",
            "commands:",
            *(f"  {name:<13}{summary}" for name, summary in commands.items()),
            "",
            f"{program} COMMAND --help lists the options of a command. With {JSON} its result is printed as JSON, and",
            f"what it says on the way goes to standard error. With {TRUST} its recipe may name classes of any package,",
            "and a checkpoint is unpickled: for files that you made yourself.",
        ]
    )


def run_command(command: str, options: list[str], program: str = "tsjepa") -> tuple[dict[str, Any], Any]:
    """Run one of :data:`COMMANDS` with ``options`` as they stand on a command line; its errors are not caught.

    Words before the first option are arguments in the order of the function's parameters: ``tsjepa export RUN NAME``.

    Returns:
        The arguments, and what the command's function returns: plain values or a path.
    """
    from tsjepa.support.allocator import keep_freed_memory

    keep_freed_memory()
    function = function_of(command)
    values = parse_arguments(function, options, f"{program} {command}", COMMANDS[command][1])
    _refuse_reader_of_a_file(values.get("reader"), options)
    with exclusive(values["output"]) if values.get("output") else nullcontext():
        return values, function(**values)


def _refuse_reader_of_a_file(reader: str | None, options: list[str]) -> None:
    """Code that the user's own words name is the user's; what a recipe names is imported only with ``--trust``."""
    typed = f"--reader={reader}" in options or ("--reader", reader) in pairwise(options)
    if reader is not None and not typed and not may_import(reader):
        raise ValueError(
            f"The recipe names the reader {reader}, which is not this package's own: add {TRUST} if you trust whoever "
            "wrote it."
        )


def function_of(command: str) -> Callable:
    """The typed function of one of :data:`COMMANDS`."""
    module, name = COMMANDS[command][0].split(":")
    return getattr(importlib.import_module(module), name)
