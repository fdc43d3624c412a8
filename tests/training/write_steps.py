"""A callback for the test of data parallelism; the processes that run a recipe find it by its name."""

from pathlib import Path

import lightning
import torch

from tsjepa.training.norm import WholeBatchNorm


class WriteSteps(lightning.Callback):
    """Writes every step's gradients, and the weights and statistics before the first step and after the last.

    One process computes the statistics of batch normalisation as several do: torch's own layer adds a hundred thousand
    numbers one by one on a CPU, which costs half of the digits.

    Args:
        folder: of the files.
    """

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder)

    def on_train_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.world_size == 1:
            WholeBatchNorm().apply(module)
        self.write(trainer, "start", module.state_dict())

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
