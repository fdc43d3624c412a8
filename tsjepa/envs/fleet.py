"""A fleet of independent plants of one kind as one batched TorchRL environment."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from tsjepa.plants.mixed import Mixed
from tsjepa.plants.plant import Plant
from tsjepa.support.checks import at_least

DONE_KEYS = ("done", "terminated", "truncated")
OWN = ("scene", "physics_state", "episode", "slot")  # what a step needs of the one before


class FleetEnv(EnvBase):
    """I plants, the last batch dimension, that step together and reset on their own.

    Nothing is rendered here: `scene` holds what a camera needs. Everything a step needs is in the tensordict
    (`physics_state`, `episode`, `slot`), so a copy of it can be stepped on as a branch. Random numbers are
    counter-based: those of device i depend on the seed, i, its episode and its slot, never on the other devices.

    Keys written: `state` [*B, n] float32; `scene` [*B, frame_history, s] float32, the newest last; `reference` [*B, r]
    float32, the set-points of this slot, where the plant has some; `reward` [*B, 1], the score of the state that the
    slot ended in; `done`, `terminated`, `truncated` [*B, 1]; and the plant's own `physics_state` [*B, p] float64,
    `episode` [*B] and `slot` [*B] int64.

    Args:
        plant: the kind of machine.
        num_devices: I.
        episode_length: slots until truncation.
        frame_history: how many of the last slots' scenes are kept. A reset device first runs frame_history - 1 slots
            from its drawn start under the command nearest to zero, so its history is real; step 0 comes after them.
        seed: seed of all streams.
        batch_size: [..., I]; default [I].
        terminate_on_failure: end an episode where the plant has failed.

    Raises:
        ValueError: at construction for a bad argument; in `step` for a command outside the actuator's range.
    """

    def __init__(
        self,
        plant: Plant,
        num_devices: int,
        episode_length: int = 100,
        frame_history: int = 1,
        seed: int = 0,
        batch_size: list[int] | None = None,
        terminate_on_failure: bool = True,
    ) -> None:
        at_least(1, num_devices=num_devices, episode_length=episode_length, frame_history=frame_history)
        shape = torch.Size([num_devices] if batch_size is None else batch_size)
        if not shape or shape[-1] != num_devices:
            raise ValueError(f"The last batch dimension must be num_devices = {num_devices}, got {list(shape)}.")
        if len(shape) > 1 and isinstance(plant, Mixed):
            raise ValueError("A batch of fleets needs devices that are alike; run mixed fleets one by one.")
        super().__init__(device="cpu", batch_size=shape)
        self.plant, self.episode_length, self.frame_history = plant, episode_length, frame_history
        self.terminate_on_failure = terminate_on_failure
        spec = plant.spec
        self._rest = np.array(spec.rest)
        self._make_specs()
        self._set_seed(seed)

    def _make_specs(self) -> None:
        shape, spec = self.batch_size, self.plant.spec
        device = np.zeros(1, np.int64)
        physics = self.plant.start(0, device, device)
        scene = self.plant.scene(physics, 0, device, device)
        reference = self.plant.references(0, device, device, device)
        self.observation_spec = Composite(
            state=Unbounded((*shape, spec.state_dim)),
            scene=Unbounded((*shape, self.frame_history, scene.shape[1])),
            physics_state=Unbounded((*shape, physics.shape[1]), dtype=torch.float64),
            episode=Unbounded(shape, dtype=torch.int64),
            slot=Unbounded(shape, dtype=torch.int64),
            shape=shape,
        )
        if reference is not None:
            self.observation_spec["reference"] = Unbounded((*shape, reference.shape[1]))
        self.state_spec = Composite({key: self.observation_spec[key].clone() for key in OWN}, shape=shape)
        low, high = (
            torch.tensor(bound).expand(*shape, spec.action_dim) for bound in (spec.action_low, spec.action_high)
        )
        self.action_spec = Bounded(low.clone(), high.clone(), (*shape, spec.action_dim), dtype=torch.float32)
        self.reward_spec = Bounded(0.0, 1.0, (*shape, 1))
        self.done_spec = Composite({key: Binary(1, (*shape, 1), dtype=torch.bool) for key in DONE_KEYS}, shape=shape)

    def _set_seed(self, seed: int | None) -> None:
        self._seed = int(seed or 0)
        self._episodes_started = np.zeros(self.numel(), np.int64)

    def push(self, tensordict: TensorDictBase, device: int, slots: float) -> TensorDictBase:
        """Hits one device of a fleet with one batch dimension, so that its controller does not know of it.

        Args:
            tensordict: the slot in which it happens; it stays as it is.
            device: which one.
            slots: the blow is what the actuator's largest command does to the machine in so many slots.

        Returns:
            The tensordict with another ``physics_state``.
        """
        rows, high = np.array([device]), np.asarray(self.plant.spec.action_high)
        physics = tensordict["physics_state"].clone()
        now = physics[rows].numpy()
        counters = (self._seed, rows, tensordict["episode"][rows].numpy(), tensordict["slot"][rows].numpy())
        pushed, left = (self.plant.advance(now, command[None], *counters) for command in (high, self._rest))
        physics[rows] += slots * torch.from_numpy(pushed - left)
        return tensordict.copy().set("physics_state", physics)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs) -> TensorDictBase:
        if tensordict is not None and "_reset" in tensordict:
            chosen = tensordict["_reset"].reshape(-1).numpy()
        else:
            chosen = np.ones(self.numel(), bool)
        device = np.flatnonzero(chosen)
        episode = self._episodes_started[device]
        self._episodes_started[device] += 1
        fresh = self._first_observation(device, episode)
        if not chosen.all():
            # TorchRL keeps the old entries of the other rows, whatever is written for them here.
            whole = fresh.new_zeros([self.numel()])
            whole[torch.from_numpy(device)] = fresh
            fresh = whole
        return fresh.reshape(self.batch_size)

    def _first_observation(self, device: np.ndarray, episode: np.ndarray) -> TensorDict:
        plant, count = self.plant, len(device)
        physics = plant.start(self._seed, device, episode)
        history = [plant.scene(physics, self._seed, device, episode)]
        rest = np.broadcast_to(self._rest, (count, len(self._rest)))
        for slot in range(1 - self.frame_history, 0):
            physics = plant.advance(physics, rest, self._seed, device, episode, np.array([slot]))
            history.append(plant.scene(physics, self._seed, device, episode))
        first = np.zeros(count, np.int64)
        observation = self._observed(physics, device, episode, first)
        observation |= {
            "scene": torch.from_numpy(np.stack(history, axis=1)),
            "episode": torch.from_numpy(episode),
            "slot": torch.from_numpy(first),
        }
        observation |= {key: torch.zeros(count, 1, dtype=torch.bool) for key in DONE_KEYS}
        return TensorDict(observation, batch_size=[count])

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        flat, plant = tensordict.reshape(-1), self.plant
        action = flat["action"].detach().numpy().astype(np.float64)
        device, episode, slot = np.arange(len(action)), flat["episode"].numpy(), flat["slot"].numpy()
        physics = plant.advance(flat["physics_state"].numpy(), action, self._seed, device, episode, slot)
        state = plant.state(physics)
        reference = plant.references(self._seed, device, episode, slot)
        terminated = torch.from_numpy(plant.failed(state) & self.terminate_on_failure)[:, None]
        truncated = (flat["slot"] + 1 >= self.episode_length)[:, None]
        newest = torch.from_numpy(plant.scene(physics, self._seed, device, episode))
        observation = self._observed(physics, device, episode, slot + 1)
        observation |= {
            "scene": torch.cat([flat["scene"][:, 1:], newest[:, None]], dim=1),
            "episode": flat["episode"].clone(),
            "slot": flat["slot"] + 1,
            "reward": torch.from_numpy(np.asarray(plant.score(state, reference), np.float32))[:, None],
            "terminated": terminated,
            "truncated": truncated,
            "done": terminated | truncated,
        }
        return TensorDict(observation, batch_size=flat.batch_size).reshape(self.batch_size)

    def _observed(self, physics: np.ndarray, device: np.ndarray, episode: np.ndarray, slot: np.ndarray) -> dict:
        observed = {
            "physics_state": torch.from_numpy(physics),
            "state": torch.from_numpy(self.plant.state(physics)).to(torch.float32),
        }
        reference = self.plant.references(self._seed, device, episode, slot)
        if reference is not None:
            observed["reference"] = torch.from_numpy(reference).to(torch.float32)
        return observed
