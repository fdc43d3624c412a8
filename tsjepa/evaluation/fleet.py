"""A fleet of cart-poles that shares a radio: the chain from plant to controller, and what one run of it measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from tensordict import TensorDictBase
from torch import Tensor

from tsjepa.envs.settings import Plants, Radio
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
from tsjepa.envs.update_codec import FRAME_CODECS, update_bits
from tsjepa.evaluation.closed_loop import run, true_state_policy
from tsjepa.evaluation.metrics import Run
from tsjepa.models import SemanticController
from tsjepa.plants.expert import Expert, linearised_plant, reference_lqr
from tsjepa.radio import SCHEDULERS

HOLD, LINEAR = "hold", "linear"
RECORDED = ("scheduled", "delivered", "age_of_information", "payload_bits")


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
        scheduler: a name in ``tsjepa.radio.SCHEDULERS``; the oracle serves everybody and loses nothing.
        seed: of the plants, the channel, and the random scheduler.
        plants, radio: the experiment.
        codec: from :func:`tsjepa.envs.update_codec.fitted_codec`.
        controller: "hold" (the expert's command on the received state, held between updates), "linear" (the expert on
            the received state, predicted by the linearised plant between updates), or a model; one without a predictor
            (the supervised baseline) has its command held between updates.

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
            units=None if bits is None else radio.units(plants.sampling_interval),
            csi=radio.csi,
            csi_delay=radio.csi_delay,
            snr_threshold_db=radio.snr_threshold_db,
        ),
    ]
    uplink = Uplink(radio.snr_threshold_db, lossless=radio.lossless or scheduler == "oracle")
    if model is None:
        chain += [Codec(codec, in_key="state"), uplink]
    else:
        camera = Camera(fleet.renderer.render, model.frame_stack, model.frame_spacing)
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
    elif isinstance(controller, SemanticController) and not controller.has_predictor:
        return HoldCommand(), lambda tensordict: controller.act(tensordict[in_key])
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
        capacity=radio.units(plants.sampling_interval) if in_units else radio.resource_blocks,
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
