"""The command line: ``tsjepa COMMAND ...``, and ``lightning COMMAND ...`` as another name for the same program.

``fit``, ``validate``, ``test`` and ``predict`` are Lightning's; every other command is one typed function, whose
arguments become options. Nothing heavy is imported before the command is known.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import inspect
import itertools
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext
from pathlib import Path

from tsjepa.cli_errors import exit_status, explain, one_sentence
from tsjepa.files import exclusive
from tsjepa.trust import TRUST, restrict_recipes

LIGHTNING_COMMANDS = {
    "fit": "train a model",
    "validate": "evaluate a checkpoint on the validation data",
    "test": "evaluate a checkpoint on the test data",
    "predict": "run a checkpoint on the prediction data",
}
COMMANDS = {
    "collect": ("tsjepa.data.collect:collect", "record a data set of frames and commands from the plant"),
    "evaluate": ("tsjepa.evaluation.evaluate:evaluate", "close the loop on held-out starts and print the table"),
    "simulate": ("tsjepa.evaluation.simulate:simulate", "run a fleet of plants that share a radio"),
    "figures": ("tsjepa.evaluation.figures.command:figures", "redraw the paper's figures, or run their sweeps"),
    "report": ("tsjepa.evaluation.figures.report:report", "compare every figure with what the paper claims"),
    "export": ("tsjepa.evaluation.export:export", "make a trained model an entry of the zoo"),
    "deploy": ("tsjepa.evaluation.deploy:deploy", "write a model as ONNX or torch.export graphs"),
    "zoo": ("tsjepa.evaluation.zoo_report:zoo", "list the pretrained models, or verify them: tsjepa zoo verify"),
    "doctor": ("tsjepa.doctor:doctor", "tell what this machine offers and what to mend"),
}


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
    trusted = TRUST in options
    options = [option for option in options if option != TRUST]
    try:
        if not trusted and command in {**LIGHTNING_COMMANDS, **COMMANDS}:
            restrict_recipes()
        if command in ("-h", "--help"):
            print(_help(program), flush=True)
        elif command == "--version":
            print(f"tsjepa {importlib.metadata.version('tsjepa')}")
        elif command in LIGHTNING_COMMANDS:
            _run_lightning(program, command, _find_recipes(options), trusted)
        elif command in COMMANDS:
            run_command(command, options, program)
        else:
            given = f"there is no command '{command}'" if command else "a command is missing"
            known = ", ".join([*LIGHTNING_COMMANDS, *COMMANDS])
            print(f"{program}: {given}; choose from {known}.", file=sys.stderr)
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


def _help(program: str) -> str:
    commands = {**LIGHTNING_COMMANDS, **{name: summary for name, (_, summary) in COMMANDS.items()}}
    return "\n".join(
        [
            f"usage: {program} COMMAND [--config RECIPE.yaml] [options]",
            "",
            "commands:",
            *(f"  {name:<10}{summary}" for name, summary in commands.items()),
            "",
            f"{program} COMMAND --help lists the options of a command. With {TRUST}, its recipe may name classes of",
            "any package, and a checkpoint is unpickled: for files that you made yourself.",
        ]
    )


def _find_recipes(options: list[str]) -> list[str]:
    """Replace ``recipes/NAME.yaml``, where the working directory has none, by the package's own (or the checkout's)."""
    return [find_recipe(option) if option.startswith("recipes/") else option for option in options]


def find_recipe(path: str) -> str:
    """The file itself where the working directory has it, else the package's own (or the checkout's), else ``path``."""
    package = Path(__file__).parent
    homes = (Path(), package, package.parent)
    return next((str(home / path) for home in homes if (home / path).is_file()), path)


def _run_lightning(program: str, command: str, options: list[str], trusted: bool) -> None:
    # Never ask for an account, nor send anything, unless the user has set the mode.
    os.environ.setdefault("WANDB_MODE", "offline")
    from lightning.pytorch.cli import LightningArgumentParser, LightningCLI, SaveConfigCallback

    from tsjepa.training.allocator import keep_freed_memory
    from tsjepa.training.callbacks import StopWhenNotFinite

    keep_freed_memory()

    class Parser(LightningArgumentParser):
        error = _error_method(f"{program} {command}")

    class SaveFitConfig(SaveConfigCallback):
        # The other commands would replace the configuration that the model was trained with.
        def setup(self, trainer, pl_module, stage: str) -> None:
            if stage == "fit":
                super().setup(trainer, pl_module, stage)

    class CommandLine(LightningCLI):
        # The recipe decides, whatever hyper-parameters a checkpoint holds; only the plugin below reads it.
        def _parse_ckpt_path(self) -> None:
            pass

        def before_instantiate_classes(self) -> None:
            options = self.config[command]
            if options.weights_only is False and not trusted:
                raise ValueError(f"weights_only is false, which would unpickle the checkpoint: add {TRUST} to do that.")
            options.weights_only = not trusted
            # The other commands print their figures; in the fit's log they would take the place of the training's.
            if command != "fit":
                options.trainer.logger = False

        # Two fits in one folder would mix their checkpoints and logs.
        def before_fit(self) -> None:
            if self.trainer.is_global_zero:
                logger = self.trainer.logger
                stack.enter_context(exclusive(logger.log_dir if logger else self.trainer.default_root_dir))

    # Lightning warns when it is handed arguments while the process has its own.
    warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
    with ExitStack() as stack:
        CommandLine(
            save_config_callback=SaveFitConfig,
            seed_everything_default=0,
            save_config_kwargs={"overwrite": True},
            auto_configure_optimizers=False,
            trainer_defaults={
                "plugins": {"class_path": "tsjepa.training.resume.AtomicCheckpointIO"},
                "callbacks": [StopWhenNotFinite()],
                # the data modules' own samplers know their process
                "use_distributed_sampler": False,
            },
            parser_class=Parser,
            parser_kwargs={"prog": program},
            args=[command, *options],
        )


def run_command(command: str, options: list[str], program: str = "tsjepa") -> None:
    """Run one of :data:`COMMANDS` with ``options`` as they stand on a command line; its errors are not caught.

    Words before the first option are arguments in the order of the function's parameters: ``tsjepa export RUN NAME``.
    """
    from jsonargparse import ArgumentParser

    class Parser(ArgumentParser):
        error = _error_method(f"{program} {command}")

    from tsjepa.training.allocator import keep_freed_memory

    keep_freed_memory()

    module, name = COMMANDS[command][0].split(":")
    function: Callable = getattr(importlib.import_module(module), name)
    parser = Parser(prog=f"{program} {command}", description=COMMANDS[command][1])
    parser.add_argument("-c", "--config", action="config", help="a YAML file with any of the options below")
    parser.add_function_arguments(function)
    values = parser.instantiate(parser.parse_args(_name_words(_find_recipes(options), function)))
    del values["config"]
    with exclusive(values["output"]) if values.get("output") else nullcontext():
        function(**values)


def _name_words(options: list[str], function: Callable) -> list[str]:
    words = itertools.takewhile(lambda option: not option.startswith("-"), options)
    named = [f"--{name}={word}" for name, word in zip(inspect.signature(function).parameters, words, strict=False)]
    return named + options[len(named) :]


def _error_method(program: str) -> Callable:
    """Replaces ``ArgumentParser.error``, which prints a usage of hundreds of options before the message."""

    def error(parser: object, message: str, cause: Exception | None = None) -> None:
        print(f"{program}: {one_sentence(message)} (options: {program} --help)", file=sys.stderr)
        raise SystemExit(2)

    return error


if __name__ == "__main__":
    sys.exit(main())
