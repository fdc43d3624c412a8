"""``fit``, ``validate``, ``test`` and ``predict``: Lightning's command line over the recipes, made safe to resume."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal

import torch
import yaml
from jsonargparse import Namespace
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI, SaveConfigCallback

from tsjepa.support.allocator import keep_freed_memory
from tsjepa.support.files import exclusive, write_text
from tsjepa.support.precision import (
    BFLOAT16,
    MEMORY_FORMATS,
    Precision,
    candidates,
    choose,
    describe,
    has_bfloat16_units,
)
from tsjepa.support.recipes import error_method, find_recipes
from tsjepa.support.trust import TRUST
from tsjepa.training.callbacks import ExportModel, Pace, StopWhenNotFinite, WritePredictions
from tsjepa.training.continuing import RecipeRules, changes, other_sizes, stored_settings
from tsjepa.training.resume import ContinuedCSVLogger, FreshLog

ROOT = "runs/fit"  # where a recipe without trainer.default_root_dir leaves its results


class SaveFitConfig(SaveConfigCallback):
    """Keeps the configuration that a model was trained with: ``config.yaml`` in default_root_dir, whatever the logger.

    The other commands would replace it.
    """

    def setup(self, trainer, pl_module, stage: str) -> None:
        if stage == "fit":
            super().setup(trainer, pl_module, stage)

    def save_config(self, trainer, pl_module, stage: str) -> None:
        folder = Path(trainer.default_root_dir)
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / self.config_filename, self.parser.dump(self.config, skip_unset=False))


def decide(given: Precision | None, trainer: Namespace, model: LightningModule) -> Precision:
    """What this fit computes in: ``given``, else what is fastest for the model's encoder on the trainer's device.

    Several processes have to decide alike, so they take the likeliest choice without a measurement.
    """
    if given is not None:
        return given
    encoder = next((part for name, part in model.named_modules() if name.split(".")[-1] == "encoder"), None)
    device = device_of(trainer.accelerator)
    alone = trainer.devices in ("auto", 1, "1", [0]) and trainer.num_nodes == 1
    alone = alone and not (trainer.devices == "auto" and device.type == "cuda" and torch.cuda.device_count() > 1)
    return choose(encoder, device) if alone else candidates(device)[0]


def as_told(settings: Namespace) -> Precision | None:
    """What the recipe or the command line says to compute in."""
    told = settings.trainer.precision
    return told and Precision(str(told), settings.memory_format or Precision.memory_format)


def as_before(stored: dict, device: torch.device) -> Precision | None:
    """What the run that is continued computes in, so that it ends as if it had never stopped.

    None where that would be emulated: the run comes from another machine.
    """
    before = (stored.get("trainer") or {}).get("precision")
    if before is None or (before == BFLOAT16 and not has_bfloat16_units(device)):
        return None
    return Precision(before, stored.get("memory_format") or Precision.memory_format)


def device_of(accelerator: object) -> torch.device:
    """The kind of device that Lightning takes for ``trainer.accelerator``."""
    if accelerator in ("auto", "gpu", "cuda") and torch.cuda.is_available():
        return torch.device("cuda")
    if accelerator in ("auto", "gpu", "mps") and torch.backends.mps.is_available():
        return torch.device("mps")
    return torch.device("cpu")


def equipment(root: Path, checkpoints: bool, asked: str | None) -> list[Callback]:
    """What every fit has, so that recipes need not name it: the result, predictions and checkpoints below ``root``.

    The export comes behind what a recipe lists, so that it writes what the finishes have made. ``asked`` is the
    checkpoint that the command names.
    """
    every = [FreshLog(asked), RecipeRules(), StopWhenNotFinite(), Pace(), ExportModel(), WritePredictions()]
    if not checkpoints:
        return every
    last = {"save_last": True, "every_n_epochs": 1, "save_on_train_epoch_end": True, "enable_version_counter": False}
    return [*every, ModelCheckpoint(dirpath=root / "checkpoints", **last)]


def run_lightning(
    command: str, options: Sequence[str], program: str = "tsjepa", trusted: bool = False
) -> dict[str, Any]:
    """Runs one of Lightning's commands.

    Args:
        command: "fit", "validate", "test" or "predict".
        options: words of the command line, such as ``--config recipes/jepa.yaml``.
        program: named in errors.
        trusted: unpickle checkpoints.

    Returns:
        The last ``metrics`` by name and, of a fit, the folder of its ``model``, that of its ``data``, and whether the
        model ``acts``. Nothing in the other processes of a parallel run.

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

        def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
            help = "of pictures in the encoder; null, as trainer.precision null: what is fastest on this machine"
            parser.add_argument("--memory_format", type=Literal[tuple(MEMORY_FORMATS)] | None, default=None, help=help)
            help = "go on from a checkpoint on another data set than its own"
            parser.add_argument("--other_data", type=bool, default=False, help=help)

        def instantiate_trainer(self, **kwargs) -> Trainer:
            settings = self.config[command]
            root = Path(settings.trainer.default_root_dir or ROOT)
            self.stored = stored_settings(root) if settings.ckpt_path else {}
            before = as_before(self.stored, device_of(settings.trainer.accelerator))
            chosen = decide(as_told(settings) or before, settings.trainer, self.model)
            # the run's config.yaml names what was chosen
            settings.trainer.precision = chosen.trainer
            settings.memory_format = settings.memory_format or chosen.memory_format
            self.model.to(memory_format=MEMORY_FORMATS[settings.memory_format])
            if settings.trainer.logger in (None, True):
                kwargs["logger"] = ContinuedCSVLogger(root.parent, name="", version=root.name)
            checkpoints = settings.trainer.enable_checkpointing is not False
            self.trainer_defaults["callbacks"] += equipment(root, checkpoints, settings.ckpt_path)
            return super().instantiate_trainer(precision=chosen.trainer, default_root_dir=root, **kwargs)

        # Two fits in one folder would mix their checkpoints and logs.
        def before_fit(self) -> None:
            if self.trainer.is_global_zero:
                stack.enter_context(exclusive(self.trainer.default_root_dir))
                settings = self.config[command]
                chosen = Precision(settings.trainer.precision, settings.memory_format)
                print(f"This fit computes in {describe(chosen, self.trainer.strategy.root_device)}.")
            self.datamodule.other_data = self.config[command].other_data
            given = yaml.safe_load(self.parser.dump(self.config, skip_link_targets=False, format="yaml"))[command]
            self.changes = changes(self.stored, given) if self.stored else []
            if self.trainer.is_global_zero:
                print(*(f"Continued: {line}.\n" for line in self.changes), sep="", end="")

        def fit(self, *arguments, **options) -> None:
            try:
                self.trainer.fit(*arguments, **options)
            except RuntimeError as error:
                sentence = other_sizes(error, self.changes)
                if sentence is None:
                    raise
                raise sentence from error

    # Lightning warns when it is handed arguments while the process has its own.
    warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
    with ExitStack() as stack:
        line = CommandLine(
            save_config_callback=SaveFitConfig,
            seed_everything_default=0,
            save_config_kwargs={"save_to_log_dir": False},
            auto_configure_optimizers=False,
            trainer_defaults={
                "plugins": [
                    {"class_path": "tsjepa.training.resume.AtomicCheckpointIO"},
                    {"class_path": "tsjepa.training.norm.WholeBatchNorm"},
                ],
                "callbacks": [],
                # the data modules' own samplers know their process
                "use_distributed_sampler": False,
            },
            parser_class=Parser,
            parser_kwargs={"prog": program, "allow_abbrev": False},
            args=[command, *find_recipes(options)],
        )
    return result_of(command, line) if line.trainer.is_global_zero else {}


def result_of(command: str, line: LightningCLI) -> dict[str, Any]:
    """What :func:`run_lightning` returns."""
    result: dict[str, Any] = {"metrics": {name: float(value) for name, value in line.trainer.callback_metrics.items()}}
    if command == "fit":
        result["acts"] = line.model.controller().acts
        result["model"] = str(Path(line.trainer.default_root_dir) / "model")
        result["data"] = str(line.datamodule.path)
    return result
