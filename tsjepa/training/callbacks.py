"""Callbacks that recipes attach by their class path."""

from __future__ import annotations

from pathlib import Path

import lightning
import numpy as np
import torch
from tensordict import TensorDictBase

from tsjepa import zoo


class ExportModel(lightning.Callback):
    """Writes the module's controller as a zoo entry when the fit ends, so that a run's result loads like any other.

    Args:
        folder: of the entry; ``tsjepa.load`` takes it.
    """

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder)

    def on_fit_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.is_global_zero:
            metrics = {name: float(value) for name, value in trainer.callback_metrics.items()}
            with torch.random.fork_rng():
                # so that parts which this fit does not train come out alike in a resumed one
                torch.manual_seed(0)
                model = module.controller()
            zoo.save(model, self.folder, metrics)
            print(f"Model written to {self.folder}.")


class WritePredictions(lightning.Callback):
    """Writes what ``tsjepa predict`` makes of the test split as named NumPy arrays.

    Args:
        path: of the ``.npz`` file.
    """

    def __init__(self, path: str) -> None:
        self.path = Path(path)

    def on_predict_batch_end(
        self, trainer, module, outputs: TensorDictBase, batch, batch_idx: int, dataloader_idx: int = 0
    ) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # NumPy has no bfloat16, in which mixed precision answers
        np.savez(self.path, **{name: tensor.float().cpu().numpy() for name, tensor in outputs.items()})
        print(f"Predictions ({', '.join(sorted(outputs.keys()))}) written to {self.path}.")
