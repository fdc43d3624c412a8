"""Runs the chain from held-out starts and writes down what happened."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import step_mdp

from tsjepa.envs.make import HOLD, LOSSLESS, make_env, make_policy
from tsjepa.envs.settings import Radio
from tsjepa.evaluation.metrics import Run
from tsjepa.models import Controller
from tsjepa.plants.plant import Plant, expert_of
from tsjepa.radio.schedulers import SchedulerFunction, periodic
from tsjepa.support.seeds import HELD_OUT

ONCE = 0  # as an update period: one update at the first slot, none after it
RECORDED = ("scheduled", "delivered", "age_of_information", "payload_bits")
SIGNALLED = "signalling_bits"  # where devices say how urgent they are

Watch = Callable[[int, TensorDictBase], None]


@dataclass(frozen=True)
class Loop:
    """One closed loop: who controls what over which radio.

    Args:
        plant: the kind of machine.
        controller: one of :data:`tsjepa.envs.make.ON_STATE`, or a model.
        scheduler: a name in ``tsjepa.radio.SCHEDULERS``, or a function; :func:`tsjepa.radio.schedulers.periodic` for an
            update every P slots.
        num_devices: I.
        slots: T.
        radio: uplink and downlink.
        frame_history: slots up to step 0, the warm-up; models of different stacks meet the same starts with the longest
            one's.
        blend: how much of a received embedding enters the belief.
        between: what a model does between updates, see :func:`tsjepa.envs.make.make_env`.
        expert: name of the plant's expert that a controller on the state uses; the first by default.
    """

    plant: Plant
    controller: str | Controller = HOLD
    scheduler: str | SchedulerFunction = "channel_aware"
    num_devices: int = 20
    slots: int = 100
    radio: Radio = LOSSLESS
    frame_history: int = 2
    blend: float = 1.0
    between: str | None = None
    expert: str | None = None

    def env(self, seed: int) -> TransformedEnv:
        """The chain with the starts and the channels of ``seed``."""
        return make_env(
            self.plant,
            self.num_devices,
            self.scheduler,
            self.radio,
            self.controller,
            seed,
            HELD_OUT + seed,
            self.slots,
            self.frame_history,
            self.blend,
            self.between,
        )

    def policy(self) -> nn.Module:
        """The far end's controller."""
        expert = expert_of(self.plant, self.expert) if self.expert else None
        return make_policy(self.plant, self.controller, self.radio, expert, self.between)


def every(loop: Loop, period: int) -> Loop:
    """The same loop with an update of every device each ``period`` slots, or :data:`ONCE`, whatever the channel."""
    return replace(loop, scheduler=periodic(period))


def perfect_feedback(loop: Loop, expert: str) -> Loop:
    """The loop of a plant's expert that is told the true state in every slot."""
    told = replace(loop, controller=HOLD, expert=expert, radio=LOSSLESS, between=None, blend=1.0)
    return every(told, 1)


@torch.no_grad()
def run(loop: Loop, seed: int, watch: Watch | None = None, env: TransformedEnv | None = None) -> Run:
    """One episode of all devices; those that fail stay in the loop.

    Args:
        loop: what is run.
        seed: of starts and channels.
        watch: called with the slot and the tensordict before each command is applied, the command in it.
        env: of the loop, where the caller has changed it.
    """
    env, policy = env or loop.env(seed), loop.policy()
    in_units = loop.radio.resource_blocks is None
    keys = (*RECORDED, *["resource_units"] * in_units, *["energy_j"] * (loop.radio.energy is not None))
    now = env.reset()
    keys = (*keys, SIGNALLED) if SIGNALLED in now else keys
    states, actions, scores, records, references = [now["state"]], [], [], [], []
    for slot in range(loop.slots):
        records.append(now.select(*keys))
        references.append(now.get("reference", None))
        now = policy(now)
        if watch is not None:
            watch(slot, now)
        following = one_slot(env, now)
        scores.append(following["reward"][..., 0])
        applied = following.get("applied_command", following.get("held_command", None))
        actions.append(now["action"] if applied is None else applied)
        states.append(following["state"])
        now = following
    record, state, action = torch.stack(records), torch.stack(states), torch.stack(actions)
    reference = None if references[0] is None else torch.stack(references)
    return _recorded(loop, record, state, action, reference, torch.stack(scores))


def one_slot(env: TransformedEnv, commanded: TensorDictBase) -> TensorDictBase:
    """What the next slot begins with, and the ``reward`` of the slot whose tensordict, with its command, is given."""
    return step_mdp(env.step(commanded), exclude_reward=False)


def _recorded(
    loop: Loop, record: TensorDictBase, state: Tensor, action: Tensor, reference: Tensor | None, score: Tensor
) -> Run:
    plant, in_units = loop.plant, loop.radio.resource_blocks is None
    expert = next(iter(plant.experts().values()))
    cost = getattr(plant, "cost", None)
    capacity = loop.radio.units(plant.spec.slot) if in_units else loop.radio.resource_blocks
    return Run(
        spec=plant.spec,
        state=state,
        action=action,
        expert_action=expert(state[:-1], reference),
        score=score,
        failed_now=torch.as_tensor(np.asarray(plant.failed(state))),
        scheduled=record["scheduled"],
        delivered=record["delivered"],
        age=record["age_of_information"],
        payload_bits=record["payload_bits"],
        signalling_bits=record.get(SIGNALLED, None),
        used=(record["resource_units"] if in_units else record["scheduled"]).sum(-1),
        capacity=capacity,
        cost=None if cost is None else cost(state[1:], action, reference),
        energy_j=record.get("energy_j", None),
    )


def optimal_scores(loop: Loop, seeds: int) -> Tensor:
    """Raw scores [seeds, I] of the plant's normaliser with perfect feedback, from the same starts and noise.

    The first I' columns belong to a fleet of I' devices.
    """
    perfect = perfect_feedback(loop, loop.plant.normaliser)
    return torch.stack([run(perfect, seed).raw_score() for seed in range(seeds)])
