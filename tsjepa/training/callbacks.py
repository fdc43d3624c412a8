"""Callbacks that recipes attach by their class path."""

from __future__ import annotations

import math
import time
from pathlib import Path

import lightning
import numpy as np
import torch
from tensordict import TensorDictBase

from tsjepa.models import entries
from tsjepa.support.files import whole
from tsjepa.support.precision import memory_format_of
from tsjepa.support.provenance import machine, provenance
from tsjepa.training.finish.callback import Finish


class StopWhenNotFinite(lightning.Callback):
    """Ends a fit whose loss or weights are no longer finite, before a checkpoint of them is written.

    Every ``tsjepa fit`` has it. A loss is looked at one step later, when the device has long computed it.
    """

    def __init__(self) -> None:
        self.loss: torch.Tensor | None = None

    def on_train_batch_end(self, trainer: lightning.Trainer, module, outputs, batch, batch_idx: int) -> None:
        self.check(trainer, self.loss)
        loss = outputs["loss"] if isinstance(outputs, dict) else outputs
        self.loss = loss.detach() if isinstance(loss, torch.Tensor) else None

    def on_validation_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.state.fn == "fit":
            self.check(trainer, self.loss, *module.parameters())

    def on_train_epoch_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        # the checkpoint's callback comes after this one
        self.check(trainer, self.loss, *module.parameters())

    def check(self, trainer: lightning.Trainer, *tensors: torch.Tensor | None) -> None:
        """Raises FloatingPointError, which names the last good checkpoint, unless all ``tensors`` are finite."""
        if all(tensor is None or bool(tensor.isfinite().all()) for tensor in tensors):
            return
        kept = getattr(trainer.checkpoint_callback, "last_model_path", "")
        advice = f"the last good checkpoint is {kept}" if kept else "there is no checkpoint yet"
        raise FloatingPointError(
            f"The loss exploded: it or the weights are not finite by step {trainer.global_step} of epoch "
            f"{trainer.current_epoch}; {advice}. Lower the learning rate, or set trainer.gradient_clip_val."
        )


class Pace(lightning.Callback):
    """Says once, after its first steps, how long the fit will take. Every ``tsjepa fit`` has it.

    The first ``SKIPPED`` steps compile kernels and fill caches; the next ``TIMED`` ones count.
    """

    SKIPPED, TIMED = 5, 20

    def on_train_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        self.steps = 0

    def on_train_batch_end(self, trainer: lightning.Trainer, module, outputs, batch, batch_idx: int) -> None:
        self.steps += 1
        if self.steps == self.SKIPPED:
            self.began = time.monotonic()
        if self.steps == self.SKIPPED + self.TIMED:
            seconds = (time.monotonic() - self.began) / self.TIMED
            finishes = [type(callback).__name__ for callback in trainer.callbacks if isinstance(callback, Finish)]
            left = trainer.estimated_stepping_batches - trainer.global_step
            trainer.print(f"This fit: {pace(seconds, left)}" + (f", then {', '.join(finishes)}." if finishes else "."))


def pace(seconds: float, left: float) -> str:
    """``seconds`` a step, and how long ``left`` more will take (infinitely many in a fit without an end)."""
    total = seconds * left
    if total == float("inf"):
        return f"{seconds:.2g} s a step"
    about = f"{total:.0f} s" if total < 90 else f"{total / 60:.0f} min" if total < 5400 else f"{total / 3600:.1f} h"
    return f"{seconds:.2g} s a step, about {about} left for {left:.0f} steps"


class ExportModel(lightning.Callback):
    """Writes the module's controller as a zoo entry when the fit ends, so that a run's result loads like any other.

    Every ``tsjepa fit`` has it. The entry is the folder "model" in the trainer's default_root_dir. A model that could
    not be stored is refused before it is trained.
    """

    def on_fit_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        entries.configuration(module.controller())

    def on_fit_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.is_global_zero:
            # JSON has no NaN, and a figure that is none is no reason to lose the model
            numbers = {name: float(value) for name, value in trainer.callback_metrics.items()}
            values = {name: number if math.isfinite(number) else None for name, number in numbers.items()}
            used = {"precision": trainer.precision, "memory_format": memory_format_of(module)}
            metrics = {"made_by": provenance(), "machine": machine() | used, **values}
            folder = Path(trainer.default_root_dir) / "model"
            entries.save(module.controller(), folder, metrics)
            print(f"Model written to {folder}.")


class WritePredictions(lightning.Callback):
    """Writes what ``tsjepa predict`` makes of the test split as named arrays: predictions.npz in default_root_dir."""

    def on_predict_batch_end(
        self, trainer, module, outputs: TensorDictBase, batch, batch_idx: int, dataloader_idx: int = 0
    ) -> None:
        path = Path(trainer.default_root_dir) / "predictions.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        # NumPy has no bfloat16, in which mixed precision answers
        with whole(path, ".npz") as partial:
            np.savez(partial, **{name: tensor.float().cpu().numpy() for name, tensor in outputs.items()})
        print(f"Predictions ({', '.join(sorted(outputs.keys()))}) written to {path}.")
