"""The chain: plant -> channel -> scheduler -> camera -> encoder -> codec -> uplink -> estimator -> actor -> plant.

Every closed loop of the package is this chain, with a scheduler and a radio of the caller's choice.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import Compose, TransformedEnv

from tsjepa.envs.fleet import FleetEnv
from tsjepa.envs.need import BY_COST, cost_of_age, watched
from tsjepa.envs.payload import sends_frames, update_bits, update_codec
from tsjepa.envs.settings import Radio
from tsjepa.envs.transforms import (
    Camera,
    Channel,
    Codec,
    Encode,
    Estimator,
    HoldCommand,
    Scheduler,
    Uplink,
    linear_model,
)
from tsjepa.envs.weights import at_weights
from tsjepa.models import Controller
from tsjepa.plants.plant import Plant
from tsjepa.radio.schedulers import SCHEDULERS, SchedulerFunction
from tsjepa.support.deal import deal

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
        radio: the uplink.
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
    model = controller if isinstance(controller, Controller) else None
    if model is not None:
        check_fit(model, plant)
        frame_history = max(frame_history, model.frame_history)
    streams = seed if plant_seed is None else plant_seed
    fleet = FleetEnv(plant, num_devices, slots, frame_history, streams, batch_size, terminate_on_failure)
    chain = [
        *radio_end(plant, num_devices, scheduler, radio, model, seed),
        far_end(controller, plant, radio, blend, between),
    ]
    return TransformedEnv(fleet, Compose(*watched(chain, scheduler, radio, plant, controller)))


def check_fit(model: Controller, plant: Plant) -> None:
    """Refuses a model whose plant has other commands, slots or pictures.

    Raises:
        ValueError: naming both values.
    """
    for name, what in (("slot", "slot in seconds"), ("frame", "frame"), ("action_low", "command range")):
        given, wanted = getattr(model.spec, name), getattr(plant.spec, name)
        if given != wanted:
            raise ValueError(
                f"The model was trained with a {what} of {given}, and the plant has {wanted}: choose a plant like the "
                "one that it was trained on."
            )


def radio_end(
    plant: Plant,
    num_devices: int,
    scheduler: str | SchedulerFunction,
    radio: Radio,
    model: Controller | None,
    seed: int,
) -> list[nn.Module]:
    """The transforms from the channel to what is received."""
    lossless = radio.lossless or scheduler == "oracle"
    codec = update_codec(radio, plant.spec, model)
    bits = update_bits(radio, plant.spec, model, codec)
    decide = partial(SCHEDULERS["random"], seed=seed) if scheduler == "random" else scheduler
    dealt = {
        name: deal(value, num_devices) if isinstance(value, tuple | list) else value
        for name, value in (("snr", radio.snr_target_db), ("bits", bits), ("priority", radio.priority))
    }
    chain = []
    if not radio.lossless:
        chain.append(
            Channel(
                radio.deployment,
                tx_power_dbm=radio.tx_power_dbm,
                snr_target_db=dealt["snr"],
                max_doppler_hz=radio.max_doppler_hz,
                sampling_interval=plant.spec.slot,
                loss=radio.loss,
                seed=seed,
            )
        )
    chain.append(
        Scheduler(
            decide,
            resource_blocks=radio.resource_blocks,
            payload_bits=dealt["bits"],
            units=None if bits is None else radio.units(plant.spec.slot),
            sampling_interval=plant.spec.slot,
            csi=radio.csi,
            csi_delay=radio.csi_delay,
            snr_threshold_db=radio.snr_threshold_db,
            max_doppler_hz=radio.max_doppler_hz,
            loss=radio.loss,
            weight=dealt["priority"],
            age_cost=cost_of_age(plant, num_devices) if scheduler in BY_COST else None,
        )
    )
    uplink = Uplink(radio.snr_threshold_db, lossless=lossless)
    if model is None:
        return [*chain, Codec(codec, in_key="state"), uplink]
    camera = Camera(plant.render, plant.spec.frame, model.frame_stack, model.frame_spacing)
    if sends_frames(radio.codec):
        remote = Encode(model.encoder, model.embedding_dim, in_key="received", mask_key="delivered")
        return [*chain, camera, Codec(codec, in_key="pixels"), uplink, remote]
    return [*chain, camera, Encode(model.encoder, model.embedding_dim), Codec(codec), uplink]


def far_end(
    controller: str | Controller, plant: Plant, radio: Radio, blend: float = 1.0, between: str | None = None
) -> nn.Module:
    """The last transform: the controller's belief, or the command that the actuator holds."""
    rest = torch.tensor(np.clip(0.0, plant.spec.action_low, plant.spec.action_high), dtype=torch.float32)
    if isinstance(controller, Controller):
        between = between or ("predict" if controller.has_predictor else "hold")
        if between != "predict":
            return HoldCommand(between, rest)
        return Estimator(at_weights(controller, controller.predict), _sent_as(radio), blend, unit_length=True)
    if controller in (HOLD, ZERO):
        return HoldCommand(controller, rest)
    if controller == LINEAR:
        model = plant.linear()
        if model is None:
            raise ValueError("This plant has no linear model; choose another controller.")
        linear = linear_model(*model)
        return Estimator(lambda state, action: linear(state, action).clamp(-FARTHEST, FARTHEST), blend=blend)
    if controller == EXACT:
        if not state_is_physics(plant):
            raise ValueError("The state of this plant is not all of its physics, so it cannot be predicted exactly.")
        return Estimator(partial(_exact, plant), blend=blend)
    raise ValueError(f"There is no controller {controller!r}; choose {', '.join(ON_STATE)} or a model.")


def _sent_as(radio: Radio) -> str:
    """Key of what the controller has received as an embedding."""
    return "embedding" if sends_frames(radio.codec) else "received"


def state_is_physics(plant: Plant) -> bool:
    """Whether a state is all that MuJoCo needs to compute the next one."""
    device = np.zeros(1, np.int64)
    physics = plant.start(0, device, device)
    return hasattr(plant, "stepper") and np.array_equal(plant.state(physics), physics)


def _exact(plant: Plant, state: Tensor, action: Tensor) -> Tensor:
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

    A controller that has heard nothing yet sends the command at rest.

    Args:
        plant, controller, radio, between: as of :func:`make_env`.
        expert: of a controller on the state; by default the plant's first.
    """
    if isinstance(controller, Controller):
        law = at_weights(controller, controller.act)
    else:
        law = expert or next(iter(plant.experts().values()))
    holds = isinstance(far_end(controller, plant, radio, between=between), HoldCommand)
    reads = (_sent_as(radio) if isinstance(controller, Controller) else "received") if holds else "belief"
    rest = torch.tensor(np.clip(0.0, plant.spec.action_low, plant.spec.action_high), dtype=torch.float32)

    @torch.no_grad()
    def act(tensordict: TensorDictBase) -> TensorDictBase:
        reference = tensordict.get("reference", None)
        command = law(tensordict[reads], reference).to(torch.float32)
        if not holds:
            command = torch.where(tensordict["informed"].unsqueeze(-1), command, rest)
        return tensordict.set("action", command)

    return _Policy(act, [reads])


class _Policy(TensorDictModuleBase):
    def __init__(self, act: Callable, in_keys: list[str]) -> None:
        super().__init__()
        self.in_keys, self.out_keys, self._act = in_keys, ["action"], act

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._act(tensordict)
