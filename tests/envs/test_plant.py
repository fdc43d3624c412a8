"""The single-device plant on dm_control."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchrl.envs import check_env_specs

from tsjepa.envs import CartPolePhysics, Renderer, StartDistribution, make_env
from tsjepa.envs.dynamics import Dynamics


def constant(force: float):
    """A policy that always applies one force."""
    return lambda td: td.set("action", torch.full((1,), force))


zero_force = constant(0.0)


def test_specs_and_keys():
    env = make_env(seed=0, random_colors=True, process_noise_std=(0.01, 0.02))
    check_env_specs(env)
    rollout = env.rollout(3, zero_force)
    assert rollout["pixels"].shape == (3, 64, 128, 3) and rollout["pixels"].dtype == torch.uint8
    assert rollout["state"].shape == (3, 4) and rollout["state"].dtype == torch.float32
    assert rollout["next", "reward"].shape == (3, 1) and rollout["next", "reward"].dtype == torch.float32
    assert rollout["action"].dtype == torch.float32
    assert env.action_spec.space.low == -20 and env.action_spec.space.high == 20


@pytest.mark.parametrize("sampling_interval", [0.001, 0.02])
def test_trajectory_is_that_of_the_batched_dynamics(sampling_interval):
    env = make_env(sampling_interval, seed=1)
    forces = torch.tensor([5.0, -20.0, 20.0, 0.5])
    given = iter(forces)
    rollout = env.rollout(4, lambda td: td.set("action", next(given)[None]))
    dynamics = Dynamics(sampling_interval)
    state = rollout["state"][:1].numpy().astype(np.float64)
    for k, force in enumerate(forces):
        state = dynamics.advance(state, np.array([force]))
        np.testing.assert_allclose(rollout["next", "state"][k], state[0], atol=1e-6)


def test_pixels_are_the_renderers():
    rollout = make_env(seed=2).rollout(2, zero_force)
    expected = Renderer().render(rollout["state"][:, :2].numpy())
    # The plant renders float64 positions, the tensordict holds float32 ones.
    assert (rollout["pixels"].numpy() != expected).mean() < 1e-3


def test_episodes_repeat_with_the_seed_and_starts_ignore_the_policy():
    def starts(force: float) -> torch.Tensor:
        env = make_env(seed=7, process_noise_std=0.02, random_colors=True, episode_length=5)
        return torch.stack([env.rollout(steps, constant(force))["state"][0] for steps in (5, 2, 3)])

    assert torch.equal(starts(0.0), starts(10.0))
    assert len(torch.unique(starts(0.0)[:, 0])) == 3
    env = make_env(process_noise_std=0.02)
    rollouts = []
    for _ in range(2):
        env.set_seed(3)
        rollouts.append(env.rollout(5, zero_force))
    assert torch.equal(rollouts[0]["next", "state"], rollouts[1]["next", "state"])
    assert torch.equal(rollouts[0]["next", "pixels"], rollouts[1]["next", "pixels"])


def test_random_colors_change_between_episodes():
    env = make_env(seed=0, random_colors=True, start=StartDistribution(0.0, 0.0, 0.0, 0.0))
    first, second = (env.reset()["pixels"] for _ in range(2))
    assert (first != second).any()


@pytest.mark.parametrize("sampling_interval", [0.001, 0.003, 0.02])
def test_truncates_after_episode_length(sampling_interval):
    env = make_env(sampling_interval, episode_length=7, start=StartDistribution(0.0, 0.0, 0.0, 0.0))
    rollout = env.rollout(20, zero_force)
    assert len(rollout) == 7
    assert rollout["next", "truncated"][-1] and not rollout["next", "terminated"].any()
    assert rollout["next", "reward"].min() == 1.0


def test_a_fall_terminates():
    rollout = make_env(seed=0).rollout(100, constant(20.0))
    assert rollout["next", "terminated"][-1] and not rollout["next", "truncated"].any()
    state = rollout["next", "state"]
    assert abs(state[-1, 1]) > 0.8 or abs(state[-1, 0]) > 1.8
    assert (state[:-1, 1].abs() <= 0.8).all()


@pytest.mark.parametrize("force", [float("nan"), 20.5])
def test_a_bad_command_is_named(force):
    env = make_env(seed=0)
    with pytest.raises(ValueError, match=str(force)):
        env.step(env.reset().set("action", torch.tensor([force])))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"episode_length": 0}, "episode_length"),
        ({"start": "anywhere"}, "anywhere"),
        ({"sampling_interval": 0.0}, "sampling_interval"),
        ({"process_noise_std": -1.0}, "process_noise_std"),
    ],
)
def test_bad_arguments_are_refused(arguments, named):
    with pytest.raises(ValueError, match=named):
        make_env(**arguments)


def test_another_camera_takes_dm_controls_path():
    physics = CartPolePhysics.for_interval(0.02)
    assert physics.render(32, 48, camera_id=-1).shape == (32, 48, 3)
    assert physics.render(camera_id=0, depth=True).dtype == np.float32
