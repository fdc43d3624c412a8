"""The radio's part of the chain: from the channel to what the controller and the actuator receive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import torch
from torch import nn

from tsjepa.envs.payload import packet_bits, sends_frames, update_bits, update_codec
from tsjepa.envs.settings import Radio
from tsjepa.envs.transforms import (
    Acknowledge,
    Actuator,
    Camera,
    Channel,
    Codec,
    Delay,
    Encode,
    Energy,
    Observe,
    Scheduler,
    TraceChannel,
    Uplink,
)
from tsjepa.envs.transforms.delay import ACKNOWLEDGED
from tsjepa.envs.transforms.uplink import AT_BASE_STATION, AT_CONTROLLER
from tsjepa.envs.weights import at_weights
from tsjepa.models import Controller, SemanticController
from tsjepa.plants.plant import Plant
from tsjepa.radio.links import McsLink
from tsjepa.radio.schedulers import SCHEDULERS, SchedulerFunction
from tsjepa.support.deal import deal


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
    uplink = Uplink(
        radio.snr_threshold_db,
        lossless=lossless,
        in_key="payload" if radio.delay is None else None,
        mcs=radio.link if isinstance(radio.link, McsLink) else None,
        demand=radio.demand,
        keys=outcome_keys(radio),
        repeats=radio.harq_ms is not None and not radio.lossless,
        seed=seed,
    )
    arrival = [uplink, *after_uplink(plant, num_devices, radio, seed)]
    links = channel(plant.spec.slot, num_devices, radio, seed)
    decides = schedule(plant, num_devices, scheduler, radio, model, codec, seed)
    if model is None:
        return [*links, decides, Codec(codec, in_key="state"), *arrival]
    camera = Camera(plant.render, plant.spec.frame, model.frame_stack, model.frame_spacing)
    if sends_frames(radio.codec):
        remote = Encode(model.encoder, model.embedding_dim, in_key="received", mask_key="delivered")
        return [*links, decides, camera, Codec(codec, in_key="pixels"), *arrival, remote]
    sees = [camera, Encode(model.encoder, model.embedding_dim)]
    if isinstance(model, SemanticController) and model.has_observer:
        remembers = Observe(at_weights(model, model.correct), warm_up(plant, model))
        return [*links, *sees, remembers, decides, Codec(codec), *arrival]
    return [*links, decides, *sees, Codec(codec), *arrival]


def warm_up(plant: Plant, model: SemanticController) -> Callable[[torch.Tensor], torch.Tensor]:
    """What a device believes [N, d] when its episode starts, from the scenes [N, frame_history, s] of its warm-up.

    It has watched every whole stack in them, under the command at rest.
    """
    at_rest, offsets = torch.tensor(plant.spec.rest), model.frame_spacing * torch.arange(model.frame_stack)
    watch = at_weights(model, lambda stacks, commands: model.belief_after(model.encode(stacks), commands))

    def begin(scenes: torch.Tensor) -> torch.Tensor:
        pictures = torch.from_numpy(plant.render(scenes.flatten(0, 1).cpu().numpy())).unflatten(0, scenes.shape[:2])
        first = torch.arange(scenes.shape[1] - model.frame_history + 1)
        return watch(pictures[:, first[:, None] + offsets], at_rest.expand(len(scenes), len(first) - 1, -1))

    return begin


def channel(slot: float, num_devices: int, radio: Radio, seed: int) -> list[nn.Module]:
    """The links in slots of ``slot`` seconds, simulated or measured; none where nothing is lost."""
    if radio.lossless:
        return []
    if radio.trace is not None:
        return [TraceChannel(radio.trace, slot, radio.trace_stretch, radio.trace_start_s, seed)]
    return [
        Channel(
            radio.deployment,
            tx_power_dbm=radio.tx_power_dbm,
            snr_target_db=dealt(radio.snr_target_db, num_devices),
            max_doppler_hz=radio.max_doppler_hz,
            sampling_interval=slot,
            loss=radio.loss,
            interference_rise_db=radio.interference_rise_db,
            repetition_s=None if radio.harq_ms is None else 1e-3 * radio.harq_ms,
            seed=seed,
        )
    ]


def dealt(value: float | Sequence[float] | None, num_devices: int) -> float | torch.Tensor | None:
    """A setting of all devices, or a list of them dealt out to the devices in turn, [I]."""
    return deal(value, num_devices) if isinstance(value, (tuple, list)) else value


def schedule(
    plant: Plant,
    num_devices: int,
    scheduler: str | SchedulerFunction,
    radio: Radio,
    model: Controller | None,
    codec: nn.Module,
    seed: int,
) -> Scheduler:
    """Who transmits, by what is known of the links."""
    bits = update_bits(radio, plant.spec, model, codec)
    decide = partial(SCHEDULERS["random"], seed=seed) if scheduler == "random" else scheduler
    needs_bits = isinstance(radio.link, McsLink)
    return Scheduler(
        decide,
        resource_blocks=radio.resource_blocks,
        payload_bits=dealt(bits, num_devices),
        units=None if bits is None else radio.units(plant.spec.slot),
        sampling_interval=plant.spec.slot,
        csi=radio.csi,
        csi_delay=radio.csi_delay,
        snr_threshold_db=radio.snr_threshold_db,
        max_doppler_hz=radio.max_doppler_hz,
        loss=radio.loss,
        decoding=radio.decoding(packet_bits(radio, plant.spec, model, codec) if needs_bits else None),
        demand=radio.demand,
        outcome_keys=ACKNOWLEDGED if radio.ack_loss else outcome_keys(radio),
        weight=dealt(radio.priority, num_devices),
    )


def outcome_keys(radio: Radio) -> tuple[str, str]:
    """Keys of outcome and age as the base station knows them: what is delayed it has before the controller."""
    return AT_CONTROLLER if radio.delay is None else AT_BASE_STATION


def after_uplink(plant: Plant, num_devices: int, radio: Radio, seed: int) -> list[nn.Module]:
    """What happens to an update that the base station has, and what it has cost."""
    chain = []
    if radio.ack_loss:
        chain.append(Acknowledge(radio.ack_loss, outcome_keys(radio)[0], seed))
    if radio.delay is not None:
        law = None if isinstance(radio.delay, str) else radio.delay
        chain.append(Delay(law, radio.delay_horizon, plant.spec.slot, seed))
    if radio.energy is not None:
        target = None if radio.trace else dealt(radio.snr_target_db, num_devices)
        chain.append(Energy(radio.energy, radio.tx_power_dbm, target))
    return chain


def actuator(plant: Plant, radio: Radio, rest: torch.Tensor, seed: int) -> list[nn.Module]:
    """The downlink and the actuator's buffer."""
    link = radio.downlink
    if link is None:
        return []
    options = {"rest": rest, "sampling_interval": plant.spec.slot, "seed": seed}
    return [Actuator(link.loss, link.delay, link.every, link.buffer, link.acknowledged, link.horizon, **options)]
