"""A fleet of cart-poles that shares a radio: the chain from plant to controller, and what one run of it measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import torch
from tensordict import TensorDictBase
from torch import Tensor

from tsjepa.envs.expert import Expert, linearised_plant, reference_lqr
from tsjepa.evaluation.closed_loop import Starts, run, true_state_policy
from tsjepa.evaluation.metrics import Run
from tsjepa.models import SemanticController
from tsjepa.network import SCHEDULERS, Deployment, GilbertElliott, IidLoss, units_per_slot
from tsjepa.network.codecs import make_codec, payload_bits
from tsjepa.network.transforms import (
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

HOLD, LINEAR = "hold", "linear"
FRAME_CODECS = ("raw", "png", "jpeg", "webp")
STATE_RANGE = (1.8, 0.8, 4.0, 4.0)  # m, rad, m/s, rad/s: what an integer codec of the true state covers
CALIBRATION_SEED = 10_000  # starts that no evaluation uses
RECORDED = ("scheduled", "delivered", "age_of_information", "payload_bits")


@dataclass(frozen=True)
class Radio:
    """The uplink that the devices share.

    Args:
        resource_blocks: J, devices that may transmit in a slot; None lets each take as many resource units as its
            payload and channel need (paper-notes, decision 16).
        payload_bits: bits that the scheduler reserves for an update where ``resource_blocks`` is None; None takes
            them from the codec, which is possible unless the codec's packets vary in length.
        codec: of what is sent, see :func:`tsjepa.network.codecs.make_codec`; a frame codec sends frames and leaves
            the encoder to the controller.
        snr_target_db: mean SNR that power control gives every device; None transmits at ``tx_power_dbm``.
        tx_power_dbm: fixed transmit power.
        snr_threshold_db: SNR below which a packet is lost.
        csi: what the scheduler knows of the channel: "perfect", "delayed" or "statistical".
        csi_delay: slots by which delayed knowledge lags.
        max_doppler_hz: 0 for fading that is independent from slot to slot.
        deployment: positions and propagation.
        loss: packet loss beside the SNR.
        lossless: everything that is scheduled arrives.
    """

    resource_blocks: int | None = 10
    payload_bits: int | None = None
    codec: str = "fp32"
    snr_target_db: float | None = 10.0
    tx_power_dbm: float = 23.0
    snr_threshold_db: float = 5.0
    csi: str = "perfect"
    csi_delay: int = 1
    max_doppler_hz: float = 0.0
    deployment: Deployment = field(default_factory=Deployment)
    loss: IidLoss | GilbertElliott | None = None
    lossless: bool = False


@dataclass(frozen=True)
class Plants:
    """The cart-poles, their controller apart.

    Args:
        slots: length of the episode that is scored.
        sampling_interval: seconds per slot.
        process_noise_std: of the noise on both velocities after every slot, m/s and rad/s.
        frame_history: frames before and including step 0, the warm-up under zero force.
    """

    slots: int = 100
    sampling_interval: float = 0.02
    process_noise_std: float = 0.008
    frame_history: int = 2

    def starts(self, seed: int, count: int) -> Starts:
        """Starts of the devices 0 .. count - 1; device i is the same plant whatever ``count`` is."""
        return Starts(seed, count, self.slots, self.frame_history, self.sampling_interval, self.process_noise_std)


@dataclass
class FleetRun:
    """What I devices did over T slots.

    Args:
        loop: their states and the commands that were applied.
        scheduled, delivered: [T, I] bool.
        age: [T, I] slots since the last delivery, 1 on delivery.
        payload_bits: [T, I] bits sent.
        capacity: what a slot offers, devices or resource units.
        used: [T], what was granted of it.
    """

    loop: Run
    scheduled: Tensor
    delivered: Tensor
    age: Tensor
    payload_bits: Tensor
    capacity: int
    used: Tensor

    def delivery_rate(self) -> float:
        """Share of the transmissions that arrive; 0 where nobody transmits."""
        return float(self.delivered.sum() / self.scheduled.sum().clamp(min=1))

    def utilisation(self) -> float:
        """Share of the radio that was granted."""
        return float(self.used.float().mean() / self.capacity)


class UnitNorm(torch.nn.Module):
    """A codec whose receiver brings what it decodes back to unit length, as the predictor and the actor expect."""

    def __init__(self, codec: torch.nn.Module) -> None:
        super().__init__()
        self.codec = codec

    def encode(self, values: Tensor):
        return self.codec.encode(values)

    def decode(self, packets) -> Tensor:
        return torch.nn.functional.normalize(self.codec.decode(packets), dim=-1)


def fitted_codec(name: str, plants: Plants, model: SemanticController | None) -> torch.nn.Module:
    """The codec of the update: of the true state, of the model's embedding, or of frames.

    Integer codecs get their ranges from the state space, or from embeddings along loops that the expert closes.
    """
    if name in FRAME_CODECS:
        if model is None:
            raise ValueError(f"The codec {name!r} sends frames, which need the encoder of a model as controller.")
        return make_codec(name, frame_stack=model.architecture.frame_stack)
    if model is None:
        codec = make_codec(name, dimension=4)
        return codec.fit(torch.tensor(STATE_RANGE) * torch.tensor([[-1.0], [1.0]])) if name[:3] == "int" else codec
    codec = make_codec(name, dimension=model.architecture.embedding_dim)
    return UnitNorm(codec.fit(calibration_embeddings(plants, model)) if name[:3] == "int" else codec)


@torch.no_grad()
def calibration_embeddings(plants: Plants, model: SemanticController, count: int = 20) -> Tensor:
    """Embeddings [N, d] of every fifth slot of expert loops from starts that no evaluation uses."""
    from tsjepa.envs import Renderer
    from tsjepa.evaluation.closed_loop import SemanticPolicy

    watcher, expert = SemanticPolicy(model, Renderer().render, 1), Expert(plants.sampling_interval)
    embeddings = []

    def watched(slot: int, observation: TensorDictBase) -> Tensor:
        if slot % 5 == 0:
            embeddings.append(model.encode(watcher.frames(observation)))
        return expert(observation["state"])

    run(replace(plants, frame_history=model.frame_history).starts(CALIBRATION_SEED, count), watched)
    return torch.cat(embeddings)


def update_bits(radio: Radio, codec: torch.nn.Module, model: SemanticController | None) -> int | None:
    """Bits the scheduler reserves for an update; None where every device takes one block."""
    if radio.resource_blocks is not None:
        return None
    if radio.payload_bits is not None:
        return radio.payload_bits
    if radio.codec in ("png", "jpeg", "webp"):
        raise ValueError(
            f"Packets of the codec {radio.codec!r} vary in length: give radio.payload_bits, the bits to reserve for "
            "one, or radio.resource_blocks."
        )
    if radio.codec == "raw":
        return payload_bits(codec.encode(torch.zeros((1, *codec.shape), dtype=torch.uint8)))[0].item()
    dimension = 4 if model is None else model.architecture.embedding_dim
    return payload_bits(codec.encode(torch.ones(1, dimension)))[0].item()


def check_scheduler(name: str) -> None:
    """ValueError that names the schedulers unless there is one of this name."""
    if name not in SCHEDULERS:
        raise ValueError(f"There is no scheduler {name!r}; choose from {', '.join(SCHEDULERS)}.")


def build_fleet(
    count: int,
    scheduler: str,
    seed: int,
    plants: Plants,
    radio: Radio,
    codec: torch.nn.Module,
    controller: str | SemanticController = HOLD,
):
    """The fleet with its radio as one TorchRL environment, and the controller as a policy.

    Plants, channels and losses depend on ``seed`` alone, so that two schedulers (or controllers) meet the same ones.

    Args:
        count: I devices.
        scheduler: a name in ``tsjepa.network.SCHEDULERS``; the oracle serves everybody and loses nothing.
        seed: of the plants, the channel, and the random scheduler.
        plants, radio: the experiment.
        codec: from :func:`fitted_codec`.
        controller: "hold" (the expert's command on the received state, held between updates), "linear" (the expert on
            the received state, predicted by the linearised plant between updates), or a TS-JEPA model.

    Returns:
        The environment, and policy(tensordict) -> action [I, 1].
    """
    from torchrl.envs import Compose, TransformedEnv

    check_scheduler(scheduler)
    model = controller if isinstance(controller, SemanticController) else None
    fleet = plants.starts(seed, count).fleet()
    bits = update_bits(radio, codec, model)
    chain = [
        Channel(
            radio.deployment,
            tx_power_dbm=radio.tx_power_dbm,
            snr_target_db=radio.snr_target_db,
            max_doppler_hz=radio.max_doppler_hz,
            sampling_interval=plants.sampling_interval,
            loss=radio.loss,
            seed=seed,
        ),
        Scheduler(
            partial(SCHEDULERS["random"], seed=seed) if scheduler == "random" else scheduler,
            resource_blocks=radio.resource_blocks,
            payload_bits=bits,
            sampling_interval=plants.sampling_interval,
            csi=radio.csi,
            csi_delay=radio.csi_delay,
            snr_threshold_db=radio.snr_threshold_db,
        ),
    ]
    uplink = Uplink(radio.snr_threshold_db, lossless=radio.lossless or scheduler == "oracle")
    if model is None:
        chain += [Codec(codec, in_key="state"), uplink]
    else:
        camera = Camera(fleet.renderer.render, model.architecture.frame_stack, model.architecture.frame_spacing)
        if radio.codec in FRAME_CODECS:
            remote = Encode(model.encode, in_key="received", mask_key="delivered")
            chain += [camera, Codec(codec, in_key="pixels"), uplink, remote]
        else:
            chain += [camera, Encode(model.encode), Codec(codec), uplink]
    controller_end, policy = _controller(controller, plants, "embedding" if radio.codec in FRAME_CODECS else "received")
    return TransformedEnv(fleet, Compose(*chain, controller_end)), policy


def _controller(controller: str | SemanticController, plants: Plants, in_key: str) -> tuple[object, Callable]:
    """The last transform and the policy of a controller."""
    expert = Expert(plants.sampling_interval)
    if controller == HOLD:
        return HoldCommand(), lambda tensordict: expert(tensordict["received"])
    if controller == LINEAR:
        linear = linear_model(*linearised_plant(plants.sampling_interval))
        # the belief about a device that is never served grows without bound; it must stay a number
        estimator, law = Estimator(lambda state, force: linear(state, force).clamp(-1e3, 1e3)), expert
    elif isinstance(controller, SemanticController):
        estimator, law = Estimator(controller.predict, in_key), controller.act
    else:
        raise ValueError(f"There is no controller {controller!r}; choose 'hold', 'linear' or a model.")

    @torch.no_grad()
    def policy(tensordict: TensorDictBase) -> Tensor:
        # a controller that has heard nothing yet sends no force
        return torch.where(tensordict["informed"].unsqueeze(-1), law(tensordict["belief"]), 0.0)

    return estimator, policy


@torch.no_grad()
def run_fleet(
    count: int,
    scheduler: str,
    seed: int,
    plants: Plants,
    radio: Radio,
    codec: torch.nn.Module,
    controller: str | SemanticController = HOLD,
) -> FleetRun:
    """One episode of a fleet; the arguments are those of :func:`build_fleet`. Failed devices stay in the fleet."""
    from torchrl.envs.utils import step_mdp

    env, policy = build_fleet(count, scheduler, seed, plants, radio, codec, controller)
    in_units = radio.resource_blocks is None
    keys = (*RECORDED, "resource_units") if in_units else RECORDED
    now = env.reset()
    states, actions, records = [now["state"]], [], []
    for _ in range(plants.slots):
        records.append(now.select(*keys))
        now = env.step(now.set("action", policy(now)))
        following = step_mdp(now)
        held = following.get("held_command", None)
        actions.append(now["action"] if held is None else held)
        states.append(following["state"])
        now = following
    record, state, action = torch.stack(records), torch.stack(states), torch.stack(actions)
    return FleetRun(
        loop=Run(state, action, Expert(plants.sampling_interval)(state[:-1])),
        scheduled=record["scheduled"],
        delivered=record["delivered"],
        age=record["age_of_information"],
        payload_bits=record["payload_bits"],
        capacity=units_per_slot(plants.sampling_interval) if in_units else radio.resource_blocks,
        used=(record["resource_units"] if in_units else record["scheduled"]).sum(-1),
    )


def optimal_scores(plants: Plants, seeds: int, count: int) -> tuple[str, Tensor]:
    """Raw scores with perfect feedback of the better of the expert and the reference LQR (paper-notes, decision 17).

    Returns:
        Which of the two, and [seeds, count]: the first I columns belong to a fleet of I devices.
    """
    scores = {
        name: torch.stack(
            [run(plants.starts(seed, count), true_state_policy(law, 1)).raw_score() for seed in range(seeds)]
        )
        for name, law in (
            ("expert", Expert(plants.sampling_interval)),
            ("reference LQR", reference_lqr(plants.sampling_interval)),
        )
    }
    best = max(scores, key=lambda name: scores[name].sum())
    return best, scores[best]
