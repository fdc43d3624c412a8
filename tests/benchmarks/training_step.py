"""Samples per second of the training as it is run, beside the same networks on a batch that is already there.

    python tests/benchmarks/training_step.py --threads 2            # collects the data set if it is absent

The first is Lightning's own loop over the DataModule: windows read from disk, augmentation, losses, optimizer, moving
average. The second is a twin of the module whose batch is resident and random and whose augmentation returns patches
that are ready. After every step of the one the twin takes one over as many slots, so both see the same machine. The
floor under both is the FLOPs of a step, counted, at the rate at which the same threads then multiply matrices in the
number format that the training computes in.
"""

import argparse
import copy
import resource
import time

import lightning
import torch
from lightning.pytorch.cli import LightningCLI
from report import publish, spread
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from tsjepa.cli.estimate import gemm_rate
from tsjepa.support.allocator import keep_freed_memory
from tsjepa.support.precision import BFLOAT16, MEMORY_FORMATS, choose
from tsjepa.training.jepa import TSJEPA
from tsjepa.training.run import device_of

COUNT_BYTES = 1024  # ru_maxrss is in kibibytes on Linux


def now() -> float:
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return time.perf_counter()


class Twin(TSJEPA):
    """A copy of a module that is not attached to a trainer."""

    global_step = 0

    def log_terms(self, *args) -> None:
        pass


class Ready(nn.Module):
    """In the place of the augmentation: patches that are ready."""

    def __init__(self, patches: torch.Tensor) -> None:
        super().__init__()
        self.patches = patches

    def forward(self, *arguments) -> torch.Tensor:
        return self.patches


class TakeTurns(lightning.Callback):
    """Times every step of the trainer, and one of the twin after it."""

    def __init__(self, warmup: int) -> None:
        self.warmup, self.trained, self.resident_seconds = warmup, [], []
        self.twin = None

    def on_train_batch_end(self, trainer, module, outputs, batch, batch_idx: int) -> None:
        timed = batch_idx > self.warmup
        if timed:
            self.trained.append(now() - self.started)
        if self.twin is None:
            self.make_twin(trainer, module, batch)
        start = now()
        self.step(trainer, batch)
        if timed:
            self.resident_seconds.append(now() - start)
        self.started = now()

    def make_twin(self, trainer, module, batch) -> None:
        shape = batch["patches"].shape
        generator = torch.Generator().manual_seed(0)
        with trainer.strategy.precision_plugin.forward_context():
            patches = module.augmentation(batch["patches"].flatten(0, 1), generator, shape[1], None)
        self.twin = copy.deepcopy(module)
        self.twin.__class__ = Twin
        self.twin.augmentation = Ready(torch.randn(patches.shape, generator=generator).to(patches))
        self.resident = torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator).to(patches.device)
        self.optimizer = self.twin.optimizer([p for p in self.twin.parameters() if p.requires_grad])
        with FlopCounterMode(display=False) as counter:
            self.step(trainer, batch)
        self.flops = counter.get_total_flops()

    def step(self, trainer, batch) -> None:
        resident = {"patches": self.resident, "commands": torch.zeros_like(batch["commands"])}
        with trainer.strategy.precision_plugin.forward_context():
            loss = self.twin.training_step(resident, 0)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.twin.on_train_batch_end(None, resident, 0)


class ChosenPrecision(LightningCLI):
    """Computes in what ``fit`` chooses on this machine."""

    def instantiate_trainer(self, **kwargs) -> lightning.Trainer:
        chosen = choose(self.model.encoder, device_of(self.config.trainer.accelerator))
        self.model.to(memory_format=MEMORY_FORMATS[chosen.memory_format])
        return super().instantiate_trainer(precision=chosen.trainer, **kwargs)


def measure(recipe: str, steps: int, warmup: int, overrides: list[str]) -> dict:
    """Trains by the recipe for a few steps and compares."""
    keep_freed_memory()
    turns = TakeTurns(warmup)
    cli = ChosenPrecision(
        run=False,
        save_config_callback=None,
        seed_everything_default=0,
        trainer_defaults={"enable_progress_bar": False},
        auto_configure_optimizers=False,
        args=[
            "--config",
            recipe,
            *("--trainer.logger", "false"),
            *("--trainer.callbacks", "null"),
            *("--trainer.enable_checkpointing", "false"),
            *("--trainer.limit_val_batches", "0"),
            *("--trainer.max_epochs", "1"),
            *("--trainer.limit_train_batches", str(steps)),
            *overrides,
        ],
    )
    cli.trainer.callbacks.append(turns)
    cli.trainer.fit(cli.model, cli.datamodule)
    if len(turns.trained) < 2:
        raise SystemExit(
            f"an epoch of this data set has too few steps for a warm-up of {warmup}; collect more episodes."
        )
    samples = cli.datamodule.frames_per_batch
    computes_in = torch.bfloat16 if cli.trainer.precision == BFLOAT16 else torch.float32
    peak = max(gemm_rate(computes_in, cli.trainer.strategy.root_device) for _ in range(5))
    ratios = [theirs / ours for ours, theirs in zip(turns.trained, turns.resident_seconds, strict=True)]
    return {
        "recipe": recipe,
        "device": str(cli.trainer.strategy.root_device),
        "threads": torch.get_num_threads(),
        "samples_per_step": samples,
        "samples_per_second": {
            "training": spread([samples / seconds for seconds in turns.trained]),
            "resident": spread([samples / seconds for seconds in turns.resident_seconds]),
        },
        "training_over_resident": {
            **spread(ratios),
            "of_total_times": sum(turns.resident_seconds) / sum(turns.trained),
            "target": 0.9,
        },
        "gigaflop_per_step": turns.flops / 1e9,
        "computes_in": str(computes_in).removeprefix("torch."),
        "gemm_gigaflop_per_second": peak / 1e9,
        "training_over_flop_floor": spread([turns.flops / peak / seconds for seconds in turns.trained]),
        "peak_memory_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * COUNT_BYTES / 2**30,
        "peak_memory_target_gib": 2,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", default="recipes/jepa.yaml")
    parser.add_argument("--steps", type=int, default=70, help="of one epoch")
    parser.add_argument("--warmup", type=int, default=4, help="steps before those that are timed")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", default="docs/results/training_step.json")
    options, overrides = parser.parse_known_args()
    torch.set_num_threads(options.threads)
    publish(options.output, measure(options.recipe, options.steps, options.warmup, overrides))


if __name__ == "__main__":
    main()
