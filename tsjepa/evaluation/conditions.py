"""What a model is judged on: its plant, its starts, and who draws the pictures."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from tsjepa.envs import Radio
from tsjepa.evaluation.rollouts import Loop
from tsjepa.models import Controller, entries
from tsjepa.plants import Plant, build_plant, describe_plant
from tsjepa.support.checks import at_least

SEEDS, STARTS_PER_SEED, SLOTS = 5, 20, 100


def load_on(name: str, device: str) -> Controller:
    """The model of a name or a folder, computing on ``device``.

    Raises:
        FileNotFoundError: there is no such model.
        ValueError: there is no such device.
    """
    model = entries.load(name)
    try:
        return model.to(device)
    except (RuntimeError, AssertionError) as error:
        raise ValueError(f"The device {device!r} cannot be used here: {str(error).splitlines()[0]}") from error


def plant_of(
    model: Controller, plant: Plant | None = None, process_noise_std: float | Sequence[float] | None = None
) -> Plant | None:
    """``plant``, else that of the model's figures, else the one that the model was trained on.

    Args:
        model: a model.
        plant: the one that is wanted.
        process_noise_std: instead of the plant's own noise.

    Returns:
        None where nobody names a plant: the model was trained on a recording.

    Raises:
        ValueError: the model's plant cannot be built, or has no such noise.
    """
    noise = {} if process_noise_std is None else {"process_noise_std": process_noise_std}
    if plant is not None:
        return build_plant(describe_plant(plant), trusted=True, **noise) if noise else plant
    described = (model.metrics or {}).get("plant") or model.plant
    return None if described is None else build_plant(described, **noise)


def held_out_loop(
    model: Controller,
    plant: Plant,
    starts_per_seed: int | None = None,
    slots: int | None = None,
    frame_history: int | None = None,
    blend: float = 1.0,
    codec: str = "fp32",
) -> Loop:
    """The loop of ``model`` on a lossless link; what is None is as in its figures, else as the constants above say.

    Raises:
        ValueError: a number below 1, a codec that there is not, or a plant that the model does not fit.
    """
    figures = model.metrics or {}
    starts_per_seed = figures.get("starts_per_seed", STARTS_PER_SEED) if starts_per_seed is None else starts_per_seed
    slots = figures.get("slots", SLOTS) if slots is None else slots
    frame_history = figures.get("frame_history", 1) if frame_history is None else frame_history
    at_least(1, starts_per_seed=starts_per_seed, slots=slots, frame_history=frame_history)
    loop = Loop(
        plant,
        model,
        num_devices=starts_per_seed,
        slots=slots,
        radio=Radio(codec=codec, lossless=True),
        frame_history=max(frame_history, model.frame_history),
        blend=blend,
    )
    loop.env(0)  # says now what does not fit together
    return loop


def warn_of_another_renderer(camera: Mapping[str, Any], *records: Mapping[str, Any] | None) -> None:
    """Prints one line where a model or a data set met the pictures of another GL renderer than the one in use.

    Args:
        camera: as :meth:`tsjepa.plants.Plant.camera` describes it.
        records: figures of a model or metadata of a data set, which may have a ``camera`` too.
    """
    known = [record for record in records if record]
    known += [data_set for record in known for data_set in record.get("data_sets", [])]
    here = camera.get("gl_renderer")
    others = {(record.get("camera") or {}).get("gl_renderer") for record in known} - {here, None}
    if here and others:
        print(
            f"Pictures are drawn by {here} here and were by {', '.join(sorted(others))} there: they differ a little, "
            "and scores may.",
            file=sys.stderr,
        )
