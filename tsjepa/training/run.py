"""``fit``, ``validate``, ``test`` and ``predict``: Lightning's command line over the recipes, made safe to resume."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from contextlib import ExitStack

from lightning.pytorch.cli import LightningArgumentParser, LightningCLI, SaveConfigCallback

from tsjepa.support.allocator import keep_freed_memory
from tsjepa.support.files import exclusive
from tsjepa.support.recipes import error_method, find_recipes
from tsjepa.support.trust import TRUST
from tsjepa.training.callbacks import StopWhenNotFinite


class SaveFitConfig(SaveConfigCallback):
    """Keeps the configuration that a model was trained with; the other commands would replace it."""

    def setup(self, trainer, pl_module, stage: str) -> None:
        if stage == "fit":
            super().setup(trainer, pl_module, stage)


def run_lightning(command: str, options: Sequence[str], program: str = "tsjepa", trusted: bool = False) -> None:
    """Runs one of Lightning's commands.

    Args:
        command: "fit", "validate", "test" or "predict".
        options: words of the command line, such as ``--config recipes/jepa.yaml``.
        program: named in errors.
        trusted: unpickle checkpoints.

    Raises:
        ValueError: the options ask for an unsafe read without ``--trust``.
        FileExistsError: another fit writes the same folder.
    """
    # Never ask for an account, nor send anything, unless the user has set the mode.
    os.environ.setdefault("WANDB_MODE", "offline")
    keep_freed_memory()

    class Parser(LightningArgumentParser):
        error = error_method(f"{program} {command}")

    class CommandLine(LightningCLI):
        # The recipe decides, whatever hyper-parameters a checkpoint holds; only the plugin below reads it.
        def _parse_ckpt_path(self) -> None:
            pass

        def before_instantiate_classes(self) -> None:
            chosen = self.config[command]
            if chosen.weights_only is False and not trusted:
                raise ValueError(f"weights_only is false, which would unpickle the checkpoint: add {TRUST} to do that.")
            chosen.weights_only = not trusted
            # The other commands print their figures; in the fit's log they would take the place of the training's.
            if command != "fit":
                chosen.trainer.logger = False

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
            args=[command, *find_recipes(options)],
        )
