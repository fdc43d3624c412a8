"""A callback for the test of data parallelism; the processes that Lightning starts find it by its name."""

from pathlib import Path

import lightning
import torch
from torch.nn.modules.batchnorm import _BatchNorm


class FrozenNorm(lightning.Callback):
    """Keeps the statistics of batch normalisation as they are, and writes every step's gradients and last weights.

    Args:
        folder: of the files.
    """

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder)

    def on_train_epoch_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        for part in module.modules():
            if isinstance(part, _BatchNorm):
                part.eval()

    def on_before_optimizer_step(
        self, trainer: lightning.Trainer, module: lightning.LightningModule, optimizer
    ) -> None:
        self.write(trainer, f"gradients{trainer.global_step}", {n: p.grad for n, p in module.named_parameters()})

    def on_train_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        self.write(trainer, "weights", module.state_dict())

    def write(self, trainer: lightning.Trainer, name: str, tensors: dict) -> None:
        """One file, from the first process."""
        if trainer.is_global_zero:
            self.folder.mkdir(parents=True, exist_ok=True)
            torch.save({key: value for key, value in tensors.items() if value is not None}, self.folder / f"{name}.pt")
