"""The chain: plant -> channel -> scheduler -> camera -> encoder -> codec -> uplink -> estimator -> actor -> downlink.

Every closed loop of the package is this chain, with a scheduler and a radio of the caller's choice.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import Compose, TransformedEnv

from tsjepa.envs.fleet import FleetEnv
from tsjepa.envs.need import watched
from tsjepa.envs.payload import sends_frames
from tsjepa.envs.radio_end import actuator, radio_end
from tsjepa.envs.settings import Radio
from tsjepa.envs.transforms import (
    Camera,
    Energy,
    Estimator,
    HierarchicalEstimator,
    HoldCommand,
    Scheduler,
    linear_model,
)
from tsjepa.envs.weights import at_weights
from tsjepa.models import Controller, HierarchicalPredictor
from tsjepa.plants.plant import Plant
from tsjepa.radio.schedulers import SCHEDULERS, SchedulerFunction

HOLD, ZERO, LINEAR, EXACT = "hold", "zero", "linear", "exact"
ON_STATE = {
    HOLD: "the expert on the received state, its command held between updates",
    ZERO: "the expert on the received state, no command between updates",
    LINEAR: "the expert on the state that the linearised plant predicts between updates",
    EXACT: "the expert on the state that the plant's own equations predict between updates, without noise",
}
FARTHEST = 1e3  # the belief about a device that is never served grows without bound; it must stay a number
LOSSLESS = Radio(lossless=True)


def make_env(
    plant: Plant,
    num_devices: int = 1,
    scheduler: str | SchedulerFunction = "channel_aware",
    radio: Radio = LOSSLESS,
    controller: str | Controller = HOLD,
    seed: int = 0,
    plant_seed: int | None = None,
    slots: int = 100,
    frame_history: int = 1,
    blend: float = 1.0,
    between: str | None = None,
    terminate_on_failure: bool = False,
    batch_size: list[int] | None = None,
) -> TransformedEnv:
    """A fleet with its radio and the far end's estimator as one TorchRL environment, whose action is the command.

    Plants, channels and losses depend on the seeds alone, so that two schedulers (or controllers) meet the same ones.

    Args:
        plant: the kind of machine.
        num_devices: I.
        scheduler: a name in ``tsjepa.radio.SCHEDULERS``, or a function; the oracle serves everybody and loses nothing.
        radio: uplink and downlink.
        controller: one of :data:`ON_STATE`, or a model, which is sent embeddings or frames.
        seed: of channel, losses and the random scheduler.
        plant_seed: of the plants, if not the same.
        slots: until an episode ends.
        frame_history: scenes that the plants remember, at least what the model stacks.
        blend: how much of a received embedding enters the belief; 1 replaces the prediction.
        between: what a model's controller does between updates: "predict", "hold" or "zero"; None predicts if it can.
        terminate_on_failure: end a device's episode where it has failed.
        batch_size: [..., I]; default [I].

    Raises:
        ValueError: an argument that does not fit the others.
    """
    # a built-in scheduler may be given as the function
    scheduler = next((name for name, function in SCHEDULERS.items() if function is scheduler), scheduler)
    model = controller if isinstance(controller, Controller) else None
    if model is not None:
        check_fit(model, plant)
        frame_history = max(frame_history, model.frame_history)
    streams = seed if plant_seed is None else plant_seed
    fleet = FleetEnv(plant, num_devices, slots, frame_history, streams, batch_size, terminate_on_failure)
    believes = far_end(controller, plant, radio, blend, between)
    chain = [
        *radio_end(plant, num_devices, scheduler, radio, model, seed),
        *actuator(plant, radio, torch.tensor(plant.spec.rest), seed),
        believes,
    ]
    parts = watched(chain, scheduler, radio, plant, controller, num_devices)
    kinds = [type(part) for part in parts]
    if Energy in kinds and Camera in kinds:
        parts[kinds.index(Energy)].watches = kinds.index(Camera) < kinds.index(Scheduler)
    return TransformedEnv(fleet, Compose(*parts))


def check_fit(model: Controller, plant: Plant) -> None:
    """Refuses a model whose plant has other commands, slots or pictures.

    Raises:
        ValueError: naming both values.
    """
    for name, what in (
        ("slot", "slot in seconds"),
        ("frame", "frame"),
        ("action_low", "smallest command"),
        ("action_high", "largest command"),
    ):
        given, wanted = getattr(model.spec, name), getattr(plant.spec, name)
        if given != wanted:
            raise ValueError(
                f"The model was trained with a {what} of {given}, and the plant has {wanted}: choose a plant like the "
                "one that it was trained on."
            )


def far_end(
    controller: str | Controller, plant: Plant, radio: Radio, blend: float = 1.0, between: str | None = None
) -> nn.Module:
    """The last transform: the controller's belief, or the command that the actuator holds."""
    if holds(controller, between):
        between = between if isinstance(controller, Controller) else controller
        return HoldCommand(between or "hold", torch.tensor(plant.spec.rest))
    embeds = isinstance(controller, Controller)
    strides = getattr(controller, "predictor", None)
    if isinstance(strides, HierarchicalPredictor):
        if blend < 1.0 or radio.delay is not None:
            raise ValueError(
                "A predictor of several strides takes what it receives as it is and in its slot: leave blend at 1 and "
                "the uplink without delay."
            )
        return HierarchicalEstimator(strides, _sent_as(radio))
    late = {"horizon": 0 if radio.delay is None else radio.delay_horizon}
    predict = prediction(controller, plant)
    return Estimator(predict, _sent_as(radio) if embeds else "received", blend, unit_length=embeds, **late)


def holds(controller: str | Controller, between: str | None = None) -> bool:
    """Whether the actuator is left with its last command (or none) until an update arrives: nothing is predicted."""
    if isinstance(controller, Controller):
        return (between or ("predict" if controller.has_predictor else "hold")) != "predict"
    return controller in (HOLD, ZERO)


def prediction(controller: str | Controller, plant: Plant) -> Callable[[Tensor, Tensor], Tensor]:
    """From beliefs [*B, d] and commands [*B, m] to the beliefs one slot later.

    Raises:
        ValueError: there is no such controller, or none for this plant.
    """
    if isinstance(controller, Controller):
        return at_weights(controller, controller.predict)
    if controller == LINEAR:
        model = plant.linear()
        if model is None:
            raise ValueError("This plant has no linear model; choose another controller.")
        linear = linear_model(*model)
        return lambda state, action: linear(state, action).clamp(-FARTHEST, FARTHEST)
    if controller == EXACT:
        if not state_is_physics(plant):
            raise ValueError("The state of this plant is not all of its physics, so it cannot be predicted exactly.")
        return partial(_exact, plant)
    raise ValueError(f"There is no controller {controller!r}; choose {', '.join(ON_STATE)} or a model.")


def _sent_as(radio: Radio) -> str:
    """Key of what the controller has received as an embedding."""
    return "embedding" if sends_frames(radio.codec) else "received"


def state_is_physics(plant: Plant) -> bool:
    """Whether a state is all that MuJoCo needs to compute the next one."""
    device = np.zeros(1, np.int64)
    physics = plant.start(0, device, device)
    return hasattr(plant, "stepper") and np.array_equal(plant.state(physics), physics)


def _exact(plant: Any, state: Tensor, action: Tensor) -> Tensor:
    """A state whose physics it is, one slot later without noise."""
    flat, force = state.reshape(-1, state.shape[-1]), action.reshape(-1, action.shape[-1])
    after = plant.stepper.advance(flat.double().numpy(), force.double().numpy())
    return torch.from_numpy(after).to(state.dtype).reshape(state.shape)


def make_policy(
    plant: Plant,
    controller: str | Controller = HOLD,
    radio: Radio = LOSSLESS,
    expert: nn.Module | None = None,
    between: str | None = None,
) -> TensorDictModuleBase:
    """The controller at the far end of :func:`make_env` as a policy: it reads its belief and writes ``action``.

    With a downlink whose packets hold several commands it also writes ``plan`` [*B, buffer, m]: it predicts its belief
    through its own commands, the set-points staying as they are. A controller that has heard nothing yet sends the
    command at rest.

    Args:
        plant, controller, radio, between: as of :func:`make_env`.
        expert: of a controller on the state; by default the plant's first.

    Raises:
        ValueError: a buffer of commands for a controller that does not predict.
    """
    if isinstance(controller, Controller):
        law = at_weights(controller, controller.act)
    else:
        law = expert or next(iter(plant.experts().values()))
    held = holds(controller, between)
    reads = (_sent_as(radio) if isinstance(controller, Controller) else "received") if held else "belief"
    resting = torch.tensor(plant.spec.rest)
    length = 1 if radio.downlink is None else radio.downlink.buffer
    if length > 1 and held:
        raise ValueError(f"A buffer of {length} commands needs a controller that predicts; this one holds its last.")
    predict: Callable = prediction(controller, plant) if length > 1 else lambda belief, action: belief

    @torch.no_grad()
    def act(tensordict: TensorDictBase) -> TensorDictBase:
        reference = tensordict.get("reference", None)
        belief = tensordict[reads]
        command = law(belief, reference).to(torch.float32)
        if held:
            return tensordict.set("action", command)
        informed = tensordict["informed"].unsqueeze(-1)
        command = torch.where(informed, command, resting)
        if length == 1:
            return tensordict.set("action", command)
        plan = [command]
        for _ in range(1, length):
            belief = predict(belief, plan[-1])
            plan.append(torch.where(informed, law(belief, reference).to(torch.float32), resting))
        return tensordict.set("action", command).set("plan", torch.stack(plan, -2))

    return _Policy(act, [reads], ["action"] if length == 1 else ["action", "plan"])


class _Policy(TensorDictModuleBase):
    def __init__(self, act: Callable, in_keys: list[str], out_keys: list[str]) -> None:
        super().__init__()
        self.in_keys, self.out_keys, self._act = in_keys, out_keys, act

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._act(tensordict)
