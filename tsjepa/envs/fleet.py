"""A fleet of independent cart-poles as one batched TorchRL environment."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from tsjepa.plants.dynamics import FORCE_LIMIT, Dynamics, check_force
from tsjepa.plants.renderer import DEFAULT_COLORS, Renderer
from tsjepa.plants.score import has_failed, in_box
from tsjepa.plants.starts import StartDistribution, draw_colors, noise_std_pair
from tsjepa.plants.streams import NOISE, normals

DONE_KEYS = ("done", "terminated", "truncated")


class FleetEnv(EnvBase):
    """I cart-poles, the last batch dimension, that step together and reset on their own.

    Nothing is rendered here: `qpos` holds what a camera needs, and `renderer` draws it. Everything a step needs is in
    the tensordict (`physics_state`, `episode`, `slot`), so a copy of it can be stepped on as a branch. Random numbers
    are counter-based: those of device i depend on the seed, i, its episode and its slot, never on the other devices.

    Keys written: `state` [*B, 4] float32 (m, rad, m/s, rad/s); `qpos` [*B, frame_history, 2] float32, the newest last;
    `colors` [*B, 2, 3] float32 RGB of cart and pole; `reward` [*B, 1], 1 in the box; `done`, `terminated`, `truncated`
    [*B, 1]; and the plant's own `physics_state` [*B, 4] float64, `episode` [*B] and `slot` [*B] int64.

    Args:
        num_devices: I.
        sampling_interval: slot length in seconds; the physics is stepped at 2 ms or less with the force held.
        process_noise_std: noise added to (x_dot, theta_dot) after every slot, standard deviations in m/s and rad/s.
        episode_length: slots until truncation.
        frame_history: how many of the last slots' qpos are kept. A reset device first runs frame_history - 1 slots
            from its drawn start under zero force, so its history is real; step 0 comes after them.
        random_colors: draw colours per device and episode instead of the default ones.
        start: distribution of the drawn start.
        seed: seed of all streams.
        batch_size: [..., I]; default [I].
        terminate_on_failure: end an episode at |theta| > 0.8 rad or |x| > 1.8 m.

    Raises:
        ValueError: at construction for a bad argument; in `step` for a force that is not in [-20, 20] N.
    """

    def __init__(
        self,
        num_devices: int,
        sampling_interval: float = 0.02,
        process_noise_std: float | tuple[float, float] = (0.0, 0.0),
        episode_length: int = 100,
        frame_history: int = 1,
        random_colors: bool = False,
        start: StartDistribution | None = None,
        seed: int = 0,
        batch_size: list[int] | None = None,
        terminate_on_failure: bool = True,
    ) -> None:
        for name, count in (
            ("num_devices", num_devices),
            ("episode_length", episode_length),
            ("frame_history", frame_history),
        ):
            if count < 1:
                raise ValueError(f"{name} must be at least 1, got {count}.")
        shape = torch.Size([num_devices] if batch_size is None else batch_size)
        if not shape or shape[-1] != num_devices:
            raise ValueError(f"The last batch dimension must be num_devices = {num_devices}, got {list(shape)}.")
        super().__init__(device="cpu", batch_size=shape)
        self.sampling_interval = sampling_interval
        self.episode_length = episode_length
        self.frame_history = frame_history
        self.random_colors = random_colors
        self.start = start or StartDistribution()
        self.terminate_on_failure = terminate_on_failure
        self.renderer = Renderer()
        self._noise_std = noise_std_pair(process_noise_std)
        self._dynamics = Dynamics(sampling_interval)
        self._make_specs()
        self._set_seed(seed)

    def _make_specs(self) -> None:
        shape = self.batch_size
        self.observation_spec = Composite(
            state=Unbounded((*shape, 4)),
            qpos=Unbounded((*shape, self.frame_history, 2)),
            colors=Bounded(0.0, 1.0, (*shape, 2, 3)),
            physics_state=Unbounded((*shape, 4), dtype=torch.float64),
            episode=Unbounded(shape, dtype=torch.int64),
            slot=Unbounded(shape, dtype=torch.int64),
            shape=shape,
        )
        self.state_spec = Composite(
            {key: self.observation_spec[key].clone() for key in ("qpos", "colors", "physics_state", "episode", "slot")},
            shape=shape,
        )
        self.action_spec = Bounded(-FORCE_LIMIT, FORCE_LIMIT, (*shape, 1))
        self.reward_spec = Bounded(0.0, 1.0, (*shape, 1))
        self.done_spec = Composite({key: Binary(1, (*shape, 1), dtype=torch.bool) for key in DONE_KEYS}, shape=shape)

    def _set_seed(self, seed: int | None) -> None:
        self._seed = int(seed or 0)
        self._episodes_started = np.zeros(self.numel(), np.int64)

    def _advance(
        self, state: np.ndarray, force: np.ndarray, device: np.ndarray, episode: np.ndarray, slot: np.ndarray
    ) -> np.ndarray:
        state = self._dynamics.advance(state, force)
        if self._noise_std.any():
            state[:, 2:] += self._noise_std * normals(self._seed, NOISE, device, episode, slot)
        return state

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
        state = self.start.draw(self._seed, device, episode)
        history = [state[:, :2]]
        for slot in range(1 - self.frame_history, 0):
            state = self._advance(state, np.zeros(len(state)), device, episode, np.array([slot]))
            history.append(state[:, :2])
        if self.random_colors:
            colors = draw_colors(self._seed, device, episode)
        else:
            colors = np.broadcast_to(DEFAULT_COLORS, (len(device), 2, 3))
        observation = {
            "qpos": torch.tensor(np.stack(history, axis=1), dtype=torch.float32),
            "colors": torch.tensor(colors, dtype=torch.float32),
            "episode": torch.from_numpy(episode),
            "slot": torch.zeros(len(device), dtype=torch.int64),
        }
        observation |= {key: torch.zeros(len(device), 1, dtype=torch.bool) for key in DONE_KEYS}
        return TensorDict(observation | _states(state), batch_size=[len(device)])

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        flat = tensordict.reshape(-1)
        force = flat["action"][:, 0].detach().numpy().astype(np.float64)
        check_force(force)
        device, episode, slot = np.arange(len(force)), flat["episode"].numpy(), flat["slot"].numpy()
        state = self._advance(flat["physics_state"].numpy(), force, device, episode, slot)
        observation = _states(state)
        newest = observation["state"][:, None, :2]
        terminated = torch.from_numpy(has_failed(state) & self.terminate_on_failure)[:, None]
        truncated = (flat["slot"] + 1 >= self.episode_length)[:, None]
        observation |= {
            "qpos": torch.cat([flat["qpos"][:, 1:], newest], dim=1),
            "colors": flat["colors"].clone(),
            "episode": flat["episode"].clone(),
            "slot": flat["slot"] + 1,
            "reward": torch.from_numpy(in_box(state)).to(torch.float32)[:, None],
            "terminated": terminated,
            "truncated": truncated,
            "done": terminated | truncated,
        }
        return TensorDict(observation, batch_size=flat.batch_size).reshape(self.batch_size)


def _states(state: np.ndarray) -> dict[str, torch.Tensor]:
    exact = torch.from_numpy(state)
    return {"physics_state": exact, "state": exact.to(torch.float32)}
