"""What a scheduler by need looks at, put into the chain in front of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.envs.payload import sends_frames
from tsjepa.envs.settings import Radio, Requests
from tsjepa.envs.transforms import (
    Actuator,
    AgeCost,
    Camera,
    Encode,
    Estimator,
    ExpectedGain,
    HierarchicalEstimator,
    Observe,
    Scheduler,
    Twin,
    Urgency,
)
from tsjepa.envs.weights import at_weights
from tsjepa.models import Controller
from tsjepa.plants.plant import Plant
from tsjepa.radio.cost import surviving_cost_table
from tsjepa.radio.schedulers import SchedulerFunction, built_in_name, name_of
from tsjepa.support.deal import deal

SAID, FIRST, EXPECTED, TRUE = "urgency", "first_contact", "expected_urgency", "genie"
BY_COST = ("channel_aware_cost", "whittle_cost")
LARGEST_AGE = 300  # slots; beyond it the cost of age is taken for constant
STARTS = 2048  # drawn of each kind of plant, to know what an error costs of a device that was never heard
NAMES = (SAID, FIRST, EXPECTED, TRUE)


def watched(
    chain: list[nn.Module],
    scheduler: str | SchedulerFunction,
    radio: Radio,
    plant: Plant,
    controller: str | Controller,
    num_devices: int,
) -> list[nn.Module]:
    """The chain with what its scheduler needs in front of it; the same chain where it needs nothing of the kind.

    Devices watch all the time for the schedulers "urgency", "first_contact" and "genie", gated or with options of their
    own too, and for one of the user's own where ``radio.requests`` is given: then camera and encoder stand before the
    scheduler.

    Args:
        chain: from the channel to the far end.
        scheduler, radio, plant, controller, num_devices: as of :func:`tsjepa.envs.make.make_env`.

    Raises:
        ValueError: a device that is to watch, and does not make what it would have to compare.
    """
    place = next(index for index, part in enumerate(chain) if isinstance(part, Scheduler))
    received = "embedding" if sends_frames(radio.codec) else "received"
    name = built_in_name(scheduler)
    if name in BY_COST:
        failed, age = twin_of(chain[-1], plant, controller).failed, chain[place].outcome_keys[1]
        return [*chain[:place], AgeCost(*cost_of_age(plant, num_devices), failed, received, age), *chain[place:]]
    asks = radio.requests is not None if name is None else name in NAMES
    if not asks:
        return chain
    twin = twin_of(chain[-1], plant, controller)
    if any(isinstance(part, Actuator) and not part.acknowledged for part in chain):
        twin = replace(twin, action_key="sent_command")
    if name == EXPECTED:
        return [*chain[:place], ExpectedGain(twin, received), *chain[place:]]
    sees = [part for part in chain if isinstance(part, (Camera, Observe)) or _encodes_pixels(part)]
    if sees and isinstance(sees[-1], Camera):
        raise ValueError(
            f"The scheduler {name_of(scheduler)!r} compares embeddings, which a device that sends frames (codec "
            f"{radio.codec!r}) does not make: choose a codec of embeddings."
        )
    key = "embedding" if sees else "state"
    requests = Requests() if radio.requests is None else radio.requests
    if name == TRUE:
        says = Urgency(twin, key)
    else:
        first = name == FIRST
        code, outcome = requests.code(), chain[place].outcome_keys[0]
        says = Urgency(twin, key, code, requests.delay, first, requests.change, outcome)
    links, rest = ([part for part in half if part not in sees] for half in (chain[:place], chain[place:]))
    return [*links, *sees, says, *rest]


def twin_of(far_end: nn.Module, plant: Plant, controller: str | Controller) -> Twin:
    """The controller behind ``far_end`` as its devices know it.

    Commands are those of the plant's expert before they saturate, in the state that a model's probe reads, where the
    expert can say them: a device that is being lost asks for more than the actuator has, and an error of its state
    would not show in what the actuator gives. Else they are the controller's own, within the actuator's range.

    Raises:
        ValueError: a controller that a device cannot run in step.
    """
    if isinstance(far_end, HierarchicalEstimator):
        raise ValueError(
            "Devices do not run a predictor of several strides in step: choose a scheduler that asks for no urgency."
        )
    low, high = (torch.tensor(bound) for bound in (plant.spec.action_low, plant.spec.action_high))
    expert, model = next(iter(plant.experts().values())), controller if isinstance(controller, Controller) else None
    predicts = isinstance(far_end, Estimator)
    probe = None if model is None else getattr(model, "probe", None)
    read = None if probe is None else at_weights(model, probe)
    unsaturated = getattr(expert, "unsaturated", None) if predicts else None
    if model is None:
        law = unsaturated or expert
    elif read is None or unsaturated is None:
        law = at_weights(model, model.act)
    else:

        def law(embedding: Tensor, reference: Tensor | None) -> Tensor:
            return unsaturated(read(embedding), reference)

    def failed(seen: Tensor) -> Tensor:
        if model is not None and read is None:
            return torch.zeros(seen.shape[:-1], dtype=torch.bool, device=seen.device)
        return torch.as_tensor(plant.failed(seen if read is None else read(seen)))

    return Twin(
        law=lambda seen, reference: law(seen, reference).to(torch.float32) / (high - low),
        failed=failed,
        predict=far_end.predict if predicts else None,
        rest=torch.tensor(plant.spec.rest) / (high - low),
        action_range=high - low,
        holds=not predicts and far_end.between == "hold",
    )


def cost_of_age(plant: Plant, num_devices: int) -> tuple[Tensor, Tensor]:
    """What an error of the state costs at the ages 0, 1, ..., of each device, [I, ages]: heard, and never heard.

    The error of a device that was heard is the noise since then; of one that was not, the state in which it started is
    unknown too. Only devices that have not failed count, since to hear of another one saves nothing.

    Raises:
        ValueError: a plant that does not say what an error costs, or that nothing disturbs.
    """
    priced, model = plant.error_cost(), plant.linear()
    if priced is None or model is None:
        raise ValueError(
            f"{type(plant).__name__} does not say what an error of its state costs (error_cost, linear): choose a "
            "scheduler without the plant's cost of age."
        )
    value, noise = priced
    if not bool((noise.diagonal(dim1=-2, dim2=-1).sum(-1) > 0).all()):
        raise ValueError("A plant without process noise is predicted without error, so that its age costs nothing.")
    kinds = 1 if model[0].ndim == 2 else len(model[0])
    device = np.arange(STARTS * kinds)
    begun = torch.as_tensor(plant.state(plant.start(0, device, np.zeros_like(device))), dtype=torch.float64)
    begun = begun.reshape(STARTS, kinds, -1).movedim(0, -2)
    return tuple(
        deal(surviving_cost_table(model[0], value, noise, error, plant.failed, LARGEST_AGE), num_devices)
        for error in (torch.zeros_like(begun), begun)
    )


def _encodes_pixels(part: nn.Module) -> bool:
    return isinstance(part, Encode) and part.in_keys == ["pixels"]
