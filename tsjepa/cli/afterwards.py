"""What to do after a command that takes long."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

# What recipes/jepa.yaml is made for: height and width of a frame in pixels, the numbers of a command, and the folders.
CARTPOLE_SIZES, CARTPOLE_DATA, JEPA_RUN = ((64, 128), 1), "data/cartpole", "runs/jepa"
PATCH, STRIDE = 4, 32  # what the sides of a frame are multiples of, for the data and for the recipe's encoder


def next_step(command: str, values: dict[str, Any], result: Any, typed: Sequence[str] = ()) -> str | None:
    """One line: what comes next and the command for it; None where nothing does.

    Args:
        command: that has ended well.
        values: its arguments.
        result: what it returned; nothing in the other processes of a parallel fit.
        typed: the words after ``command`` as they were given.
    """
    return STEPS[command](values, result, shlex.join(typed)) if result and command in STEPS else None


def _after_fit(values: dict, result: dict, typed: str) -> str:
    from tsjepa.data.storage import read_metadata

    model, data = result["model"], result["data"]
    if result["acts"]:
        closes = read_metadata(data).get("plant") is not None
        what = "close the loop with it" if closes else "see how near its commands are to the recorded ones"
        return f"{what}: tsjepa evaluate --model {model} --data {data}"
    return _fit_actor(model, data)


def _fit_actor(model: str, data: str) -> str:
    folder = Path(model).parent
    words = f"--model.init_args.pretrained {model} --data.init_args.path {data}{_without_actor_splits(data)}"
    if folder != Path(JEPA_RUN):  # else the actor of another model would be lost
        name = folder.name.replace("jepa", "actor") if "jepa" in folder.name else f"{folder.name}-actor"
        words += f" --trainer.default_root_dir {folder.with_name(name)}"
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


def _after_evaluate(values: dict, result: dict, typed: str) -> str:
    if "closed_loop" in result:
        return f"put a fleet of them on one radio: tsjepa simulate --controller {values['model']}"
    if "command_nmae" not in result["open_loop"]:
        return _fit_actor(values["model"], values["data"])
    return f"bring it to a device: tsjepa deploy {values['model']} deployed"


def _after_data(values: dict, path: Path, typed: str) -> str:
    from tsjepa.data.storage import read_metadata, spec_of

    metadata = read_metadata(path)
    spec = spec_of(metadata)
    (height, width), (frame, commands) = spec.frame, CARTPOLE_SIZES
    if "size" in values and (height % PATCH or width % PATCH):
        size = [max(STRIDE, STRIDE * round(side / STRIDE)) for side in (height, width)]
        return f"take sides that are multiples of {STRIDE}: tsjepa import {typed} --size '{size}'"
    words = f"--data.init_args.path {path} --data.init_args.collect null"
    encoder = "--model.init_args.encoder"
    if height % STRIDE or width % STRIDE:
        sizes = f"embedding_dim: 64, widths: null, height: {height}, width: {width}"
        words += f" {encoder} '{{class_path: tsjepa.models.DifferenceEncoder, init_args: {{{sizes}}}}}'"
    elif (height, width) != frame:
        words += f" {encoder}.init_args.height {height} {encoder}.init_args.width {width}"
    if spec.action_dim != commands:
        words += f" --model.init_args.predictor.init_args.action_dim {spec.action_dim}"
    if "validation" not in metadata["splits"]:
        words += " --trainer.limit_val_batches 0"
    if Path(path) != Path(CARTPOLE_DATA):  # else the main job's model would be lost
        words += f" --trainer.default_root_dir {JEPA_RUN}-{Path(path).name}"
    return f"train on it: tsjepa fit --config recipes/jepa.yaml {words}"


def _after_simulate(values: dict, result: dict, typed: str) -> str | None:
    if "search" in result:
        return None
    count, blocks = values["num_devices"], values["radio"].resource_blocks or 1
    sizes = sorted({max(size, blocks) for size in (count // 4, count // 2, count, 2 * count, 4 * count)} - {0})
    words = f"--num_devices null --search_over '{sizes}' --output {values['output']}-search"
    if values["record"] is not None:
        words += " --record null"
    return f"find how many each scheduler serves: tsjepa simulate {f'{typed} {words}'.lstrip()}"


STEPS: dict[str, Callable[[dict, Any, str], str | None]] = {
    "fit": _after_fit,
    "collect": _after_data,
    "import": _after_data,
    "evaluate": _after_evaluate,
    "simulate": _after_simulate,
    "export": lambda values, result, typed: f"score it again from its files: tsjepa zoo verify {result['entry']}",
    "figures": lambda values, result, typed: "set them beside the paper's claims: tsjepa report",
}
