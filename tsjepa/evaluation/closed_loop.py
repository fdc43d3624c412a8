"""Closed loops of one controller: an update every P slots, and prediction, hold-last or zero in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn


ONCE = 0  # as an update period: one update at the first slot, none after it

Policy = Callable[[int, dict[str, Tensor]], Tensor]


@dataclass
class Starts:
    """The held-out evaluation starts: |x| <= 0.8, |theta| <= 0.3, velocities within 0.3, after the warm-up frames.

    Args:
        seed: of this set of starts; training data use other streams.
        count: N.
        slots: T.
        frame_history: frames before and including step 0; the warm-up runs under zero force.
        sampling_interval: seconds.
        process_noise_std: see :class:`tsjepa.envs.FleetEnv`.
    """

    seed: int
    count: int = 20
    slots: int = 100
    frame_history: int = 2
    sampling_interval: float = 0.02
    process_noise_std: float = 0.0

    def fleet(self):
        """A fleet that begins at these starts, failures included to the last slot."""
        from tsjepa.envs import FleetEnv
        from tsjepa.plants import CartPole

        plant = CartPole(self.sampling_interval, self.process_noise_std)
        seed = 1_000_000 + self.seed
        return FleetEnv(plant, self.count, self.slots, self.frame_history, seed, terminate_on_failure=False)


def is_update(slot: int, period: int) -> bool:
    """Whether something is sent in ``slot`` with an update every ``period`` slots, or :data:`ONCE`."""
    return slot == 0 if period == ONCE else slot % period == 0


@torch.no_grad()
def run(starts: Starts, policy: Policy) -> tuple[Tensor, Tensor]:
    """Drives the plants of ``starts`` with ``policy(slot, observation) -> action [N, 1]``."""
    fleet = starts.fleet()
    observation = fleet.reset()
    states, actions = [observation["state"]], []
    for slot in range(starts.slots):
        action = policy(slot, observation)
        observation = fleet.step(observation.set("action", action))["next"]
        states.append(observation["state"])
        actions.append(action)
    state = torch.stack(states)
    return state, torch.stack(actions)


def true_state_policy(law: Callable[[Tensor], Tensor], period: int, between: str = "hold") -> Policy:
    """The expert on the true state, applied at updates; in between the last command is held, or none (``"zero"``)."""
    command = None

    def policy(slot: int, observation) -> Tensor:
        nonlocal command
        if is_update(slot, period):
            command = law(observation["state"])
            return command
        return command if between == "hold" else torch.zeros_like(command)

    return policy


class SemanticPolicy:
    """Encodes at updates and predicts in between, then acts; without a predictor it holds its command in between.

    Args:
        model: a controller of the zoo.
        render: from qpos [N, 2] and colours to frames, as :class:`tsjepa.envs.Renderer` has it.
        period: slots between updates, or :data:`ONCE`.
        blend: how much of a received embedding enters the belief; 1 replaces the prediction.
        codec: what the radio does to an embedding (quantisation), or None.

    After each slot ``belief`` holds the embedding that was acted on last, [N, d].
    """

    def __init__(
        self,
        model: nn.Module,
        render: Callable,
        period: int,
        blend: float = 1.0,
        codec: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        self.model, self.render, self.period, self.blend, self.codec = model, render, period, blend, codec
        self.belief = None

    def __call__(self, slot: int, observation) -> Tensor:
        predicts = self.model.has_predictor
        predicted = self.model.predict(self.belief, self.command) if predicts and slot > 0 else None
        if is_update(slot, self.period):
            received = self.model.encode(self.frames(observation))
            received = received if self.codec is None else self.codec(received)
            if predicted is not None and self.blend < 1:
                received = torch.nn.functional.normalize(torch.lerp(predicted, received, self.blend), dim=-1)
            self.belief = received
        elif predicts:
            self.belief = predicted
        else:
            return self.command
        self.command = self.model.act(self.belief)
        return self.command

    def frames(self, observation) -> Tensor:
        """Stacks [N, frame_stack, H, W, 3] of the observed devices; they may remember more than a stack spans."""
        scene = observation["scene"][:, -self.model.frame_history :: self.model.frame_spacing]
        return torch.from_numpy(self.render(scene.flatten(0, 1).numpy())).unflatten(0, scene.shape[:2])
