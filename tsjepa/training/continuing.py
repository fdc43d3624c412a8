"""What differs between a run and the command that continues it: said before it goes on, and made so."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lightning
import yaml
from torch.optim import Optimizer

# of the command that continues, and of no run
OWN = ("ckpt_path", "config", "weights_only", "other_data")
MISMATCH = re.compile(r"size mismatch for (\S+): .*?torch.Size\((.*?)\) from checkpoint, .*?torch.Size\((.*?)\)")


def stored_settings(folder: Path) -> dict:
    """The ``config.yaml`` of the run in ``folder``; empty where there is none."""
    path = folder / "config.yaml"
    return yaml.safe_load(path.read_text()) if path.is_file() else {}


def changes(stored: dict, given: dict) -> list[str]:
    """A line for each setting that is not as the run had it."""
    before, now = dict(_flat(stored)), dict(_flat(given))
    return [
        f"{name} is {now.get(name, 'left out')}, the run had {before.get(name, 'nothing')}"
        for name in dict.fromkeys([*before, *now])
        if name.split(".")[0] not in OWN and before.get(name) != now.get(name)
    ]


def _flat(settings: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Pairs of dotted name and value of nested settings; one that is empty or null is none."""
    if isinstance(settings, dict):
        for key, value in settings.items():
            yield from _flat(value, f"{name}.{key}" if name else key)
    elif isinstance(settings, list) and any(isinstance(item, (dict, list)) for item in settings):
        for index, value in enumerate(settings):
            yield from _flat(value, f"{name}[{index}]")
    elif settings not in (None, [], ""):
        yield name, settings


def other_sizes(error: RuntimeError, differing: list[str]) -> ValueError | None:
    """The sentence for weights that do not fit the model, or None for another error.

    Args:
        error: that torch raised.
        differing: what :func:`changes` found.
    """
    if "loading state_dict" not in str(error):
        return None
    model = [line for line in differing if line.startswith("model.")]
    found = MISMATCH.search(str(error))
    reason = "; ".join(model) or (f"{found[1]} has the shape {found[2]} in it and {found[3]} here" if found else "")
    reason = reason or "it holds other parts"
    return ValueError(f"The checkpoint is of another model than the recipe's: {reason}. Give the run's own sizes.")


class RecipeRules(lightning.Callback):
    """Keeps the recipe's optimizer and schedule in a fit that goes on from a checkpoint, and says what that changes.

    A checkpoint restores its own, whatever the recipe or the command line says. Every ``tsjepa fit`` has it.
    """

    def on_train_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        configured = module.configure_optimizers() if trainer.ckpt_path else None
        if not isinstance(configured, dict) or len(trainer.optimizers) != 1:
            return
        said = set_options(trainer.optimizers[0], configured["optimizer"])
        for current, wanted in zip(trainer.lr_scheduler_configs, [configured.get("lr_scheduler")], strict=False):
            said += set_schedule(current.scheduler, wanted["scheduler"], configured["optimizer"])
        for line in said:
            trainer.print(f"From here on {line}.")


def set_options(optimizer: Optimizer, wanted: Optimizer) -> list[str]:
    """Gives ``optimizer`` the options of ``wanted``, which has no history; lines on what changed.

    A peak of the learning rate that changed scales the present rate alike.
    """
    said = []
    for group, new in zip(optimizer.param_groups, wanted.param_groups, strict=True):
        peak, new_peak = (options.get("initial_lr", options["lr"]) for options in (group, new))
        if peak != new_peak:
            said.append(f"lr is {new_peak}, the checkpoint had {peak}")
            group |= {"lr": group["lr"] * new_peak / peak if peak else new["lr"], "initial_lr": new_peak}
        for name in new.keys() - {"params", "lr", "initial_lr"}:
            if group.get(name) != new[name]:
                said.append(f"{name} is {new[name]}, the checkpoint had {group.get(name)}")
                group[name] = new[name]
    return sorted(set(said))


def set_schedule(schedule: Any, wanted: Any, optimizer: Optimizer) -> list[str]:
    """Gives ``schedule`` the arguments of ``wanted`` and the peaks of ``optimizer``; lines on what changed."""
    said = []
    if hasattr(schedule, "base_lrs"):
        schedule.base_lrs = [group.get("initial_lr", group["lr"]) for group in optimizer.param_groups]
    for name in inspect.signature(type(wanted)).parameters:
        old, new = getattr(schedule, name, None), getattr(wanted, name, None)
        if name not in ("optimizer", "last_epoch", "lr_lambda") and old != new:
            said.append(f"{name} is {new}, the checkpoint had {old}")
            setattr(schedule, name, new)
    return said
