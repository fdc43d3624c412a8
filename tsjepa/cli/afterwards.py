"""What to do after a command that takes long."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

# What recipes/jepa.yaml is made for: height and width of a frame in pixels, and the numbers of a command.
CARTPOLE_SIZES = ((64, 128), 1)


def next_step(command: str, values: dict[str, Any], result: Any) -> str | None:
    """One line: what comes next and the command for it; None where nothing does.

    Args:
        command: that has ended well.
        values: its arguments.
        result: what it returned; nothing in the other processes of a parallel fit.
    """
    return STEPS[command](values, result) if result and command in STEPS else None


def _after_fit(values: dict, result: dict) -> str:
    model, data = result["model"], result["data"]
    if result["acts"]:
        return f"close the loop with it: tsjepa evaluate --model {model} --data {data}"
    words = f"--model.init_args.pretrained {model} --data.init_args.path {data}{_without_actor_splits(data)}"
    return f"train the actor on it: tsjepa fit --config recipes/actor.yaml {words}"


def _without_actor_splits(data: str) -> str:
    """What recipes/actor.yaml is told of a data set that has none of its splits, such as a recording."""
    from tsjepa.data.storage import read_metadata, spec_of

    metadata = read_metadata(data)
    if "actor_train" in metadata["splits"]:
        return ""
    held_out = [name for name in ("validation", "test") if name in metadata["splits"]] or ["train"]
    finishes = ["probe.FitProbe"] * bool(spec_of(metadata).state_dim) + ["decoder.FitDecoder", "codec.FitCodec"]
    callbacks = ", ".join(
        f"{{class_path: tsjepa.training.finish.{finish}, init_args: {{splits: [train]}}}}" for finish in finishes
    )
    return (
        f" --data.init_args.collect null --data.init_args.splits '[train]' --data.init_args.validation {held_out[0]} "
        f"--data.init_args.test {held_out[-1]} --trainer.callbacks '[{callbacks}]'"
    )


def _after_evaluate(values: dict, result: dict) -> str:
    if "closed_loop" in result:
        return f"put a fleet of them on one radio: tsjepa simulate --controller {values['model']}"
    return f"bring it to a device: tsjepa deploy {values['model']} deployed"


def _after_data(path: Path) -> str:
    from tsjepa.data.storage import read_metadata, spec_of

    metadata = read_metadata(path)
    spec = spec_of(metadata)
    words = f"--data.init_args.path {path} --data.init_args.collect null"
    frame, commands = CARTPOLE_SIZES
    if tuple(spec.frame) != frame:
        encoder = "--model.init_args.encoder.init_args"
        words += f" {encoder}.height {spec.frame[0]} {encoder}.width {spec.frame[1]}"
    if spec.action_dim != commands:
        words += f" --model.init_args.predictor.init_args.action_dim {spec.action_dim}"
    if "validation" not in metadata["splits"]:
        words += " --trainer.limit_val_batches 0"
    return f"train on it: tsjepa fit --config recipes/jepa.yaml {words}"


STEPS: dict[str, Callable[[dict, Any], str]] = {
    "fit": _after_fit,
    "collect": lambda values, path: _after_data(path),
    "import": lambda values, path: _after_data(path),
    "evaluate": _after_evaluate,
    "simulate": lambda values, result: (
        "find how many each scheduler serves: tsjepa simulate --config recipes/fleet-search.yaml "
        f"--controller {values['controller']}"
    ),
    "export": lambda values, result: f"score it again from its files: tsjepa zoo verify {result['entry']}",
    "figures": lambda values, result: "set them beside the paper's claims: tsjepa report",
}
