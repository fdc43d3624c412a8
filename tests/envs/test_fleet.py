"""The fleet: TorchRL's contract, independence of its devices, seeds, warm-up and errors."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from torchrl.envs import StepCounter, TransformedEnv, check_env_specs
from torchrl.envs.utils import step_mdp

from tsjepa.envs import FleetEnv
from tsjepa.plants import CartPole

NOISE = (0.03, 0.05)
STILL = (0.0, 0.0, 0.0, 0.0)


def make(num_devices: int, plant: dict | None = None, **arguments) -> FleetEnv:
    """A fleet of cart-poles."""
    return FleetEnv(CartPole(**(plant or {})), num_devices, **arguments)


def push(env: FleetEnv, seed: int = 0):
    """A policy of random forces of at most 5 N, the same for the same seed."""
    generator = torch.Generator().manual_seed(seed)
    return lambda td: td.set("action", 10 * torch.rand(*env.batch_size, 1, generator=generator) - 5)


def constant(force: float, count: int):
    """A policy that always applies one force."""
    return lambda td: td.set("action", torch.full((count, 1), force))


def run(env: FleetEnv, steps: int, tensordict, forces, resets=None):
    """Step under `forces` [steps, *B, 1], resetting the given devices before given steps; states [steps, *B, 4]."""
    states = []
    for k in range(steps):
        if resets and k in resets:
            chosen = torch.zeros(*env.batch_size, 1, dtype=torch.bool)
            chosen[resets[k]] = True
            tensordict = env.reset(tensordict.set("_reset", chosen))
        tensordict = step_mdp(env.step(tensordict.set("action", forces[k])))
        states.append(tensordict["physics_state"])
    return torch.stack(states)


@pytest.mark.parametrize("batch_size", [None, [2, 3]])
@pytest.mark.parametrize("frame_history", [1, 3])
def test_specs(batch_size, frame_history):
    coloured = {"process_noise_std": NOISE, "random_colors": True}
    env = make(3, coloured, frame_history=frame_history, batch_size=batch_size)
    check_env_specs(env)
    rollout = env.rollout(4, break_when_any_done=False)
    assert rollout.batch_size == (*(batch_size or [3]), 4)
    assert rollout["scene"].shape[-2:] == (frame_history, 2 + 2 * 3)
    for key in ("state", "scene", "reference", "action"):
        assert rollout[key].dtype == torch.float32
    assert rollout["next", "reward"].shape == (*rollout.batch_size, 1)


def test_one_millisecond_slots():
    env = make(2, {"sampling_interval": 0.001, "start_half_widths": STILL})
    check_env_specs(env)
    stepped = env.step(env.reset().set("action", torch.tensor([[20.0], [-20.0]])))
    speed = stepped["next", "state"][:, 2]
    # The cart's acceleration at rest is F / (M + m/4) for a uniform rod on a frictionless hinge, bar the rod's ends.
    torch.testing.assert_close(speed, torch.tensor([20.0, -20.0]) / 1.025 * 0.001, rtol=5e-3, atol=0)


def test_resetting_one_device_leaves_the_others_bit_identical():
    forces = 4 * torch.rand(12, 3, 1, generator=torch.Generator().manual_seed(1)) - 2
    states = []
    for resets in (None, {4: 1, 9: 1}):
        env = make(3, {"process_noise_std": NOISE}, frame_history=3, seed=5)
        states.append(run(env, 12, env.reset(), forces, resets))
    assert torch.equal(states[0][:, [0, 2]], states[1][:, [0, 2]])
    assert torch.equal(states[0][:4, 1], states[1][:4, 1])
    assert (states[0][4:, 1] != states[1][4:, 1]).all()


def test_partial_reset_keeps_every_entry_of_the_others():
    env = make(3, {"random_colors": True}, frame_history=2)
    before = step_mdp(env.step(push(env)(env.reset())))
    chosen = torch.tensor([[False], [True], [False]])
    after = env.reset(before.clone().set("_reset", chosen))
    for key in ("state", "scene", "reference", "physics_state", "episode", "slot", "done"):
        assert torch.equal(after[key][[0, 2]], before[key][[0, 2]]), key
    assert after["slot"].tolist() == [1, 0, 1] and after["episode"].tolist() == [0, 1, 0]
    assert (after["scene"][1, :, 2:] != before["scene"][1, :, 2:]).all()


def test_a_device_does_not_depend_on_the_size_of_the_fleet():
    forces = torch.zeros(6, 5, 1)
    small, large = (make(count, {"process_noise_std": NOISE}, seed=2) for count in (2, 5))
    assert torch.equal(run(large, 6, large.reset(), forces)[:, :2], run(small, 6, small.reset(), forces[:, :2]))


def test_rows_of_a_larger_batch_differ():
    start = make(3, batch_size=[2, 3]).reset()["state"]
    assert len(torch.unique(start[..., 0])) == 6


def test_starts_depend_on_seed_and_episode_but_not_on_the_policy():
    second_starts = []
    for policy in (constant(0.0, 4), constant(15.0, 4)):
        env = make(4, {"process_noise_std": NOISE}, seed=3)
        first = env.reset()["state"]
        env.rollout(5, policy)
        second_starts.append(env.reset()["state"])
    assert (first != second_starts[0]).all()
    # The roll-out began an episode of its own in both.
    assert torch.equal(*second_starts)
    assert (make(4, seed=4).reset()["state"] != first).all()


def test_set_seed_starts_over():
    env = make(3, {"process_noise_std": NOISE}, seed=0)
    rollouts = []
    for _ in range(2):
        env.set_seed(11)
        rollouts.append(env.rollout(5, push(env))["next", "state"])
    assert torch.equal(*rollouts)


def test_a_copy_of_the_tensordict_is_a_branch():
    env = make(2, {"process_noise_std": NOISE})
    root = env.reset()
    forces = torch.ones(5, 2, 1)
    first = run(env, 5, root.clone(), forces)
    run(env, 5, root.clone(), -forces)
    assert torch.equal(run(env, 5, root.clone(), forces), first)
    assert torch.equal(run(copy.deepcopy(env), 5, root.clone(), forces), first)


def test_warm_up_makes_a_real_history():
    env = make(3, frame_history=4, seed=1)
    reset = env.reset()
    path = [env.plant.start(1, np.arange(3), np.zeros(3, np.int64))]
    for _ in range(3):
        path.append(CartPole().stepper.advance(path[-1], np.zeros((3, 1))))
    np.testing.assert_array_equal(reset["physics_state"], path[-1])
    expected = np.stack(path, axis=1)[..., :2].astype(np.float32)
    np.testing.assert_array_equal(reset["scene"][..., :2], expected)
    stepped = env.step(reset.set("action", torch.zeros(3, 1)))
    assert torch.equal(stepped["next", "scene"][:, :-1], reset["scene"][:, 1:])
    assert torch.equal(stepped["next", "scene"][:, -1, :2], stepped["next", "state"][:, :2])


def test_process_noise_has_its_standard_deviations():
    env = make(3000, {"process_noise_std": NOISE, "start_half_widths": STILL, "sampling_interval": 0.002})
    velocity = env.step(env.reset().set("action", torch.zeros(3000, 1)))["next", "state"][:, 2:]
    torch.testing.assert_close(velocity.std(0), torch.tensor(NOISE), rtol=0.05, atol=0)
    assert abs(np.corrcoef(velocity.T)[0, 1]) < 0.08


def test_reward_termination_and_truncation():
    env = make(4, {"start_half_widths": STILL}, episode_length=3)
    tensordict = env.reset()
    # In the box; outside it; fallen; off the rail.
    tensordict["physics_state"][:, 0] = torch.tensor([0.0, 0.1, 0.0, 1.85])
    tensordict["physics_state"][:, 1] = torch.tensor([0.0, 0.0, 0.9, 0.0])
    kept_on = make(4, episode_length=3, terminate_on_failure=False)
    assert not kept_on.step(tensordict.clone().set("action", torch.zeros(4, 1)))["next", "done"].any()
    stepped = env.step(tensordict.set("action", torch.zeros(4, 1)))["next"]
    assert stepped["reward"].flatten().tolist() == [1.0, 0.0, 0.0, 0.0]
    assert stepped["terminated"].flatten().tolist() == [False, False, True, True]
    assert not stepped["truncated"].any()
    rollout = make(2, {"start_half_widths": STILL}, episode_length=3).rollout(10, push(make(2)))
    assert rollout["next", "truncated"].squeeze(-1).tolist() == [[False, False, True]] * 2
    assert torch.equal(rollout["next", "done"], rollout["next", "truncated"])


def test_done_devices_reset_on_their_own():
    env = TransformedEnv(make(2, {"start_half_widths": STILL}, episode_length=50, frame_history=2), StepCounter())
    # Device 0 is pushed over, device 1 is left alone.
    forces = torch.tensor([[20.0], [0.0]])
    rollout = env.rollout(40, lambda td: td.set("action", forces), break_when_any_done=False)
    ends = rollout["next", "terminated"][0].squeeze(-1)
    assert ends.any() and not rollout["next", "done"][1].any()
    assert torch.equal(rollout["episode"][0, 1:], ends.cumsum(0)[:-1])
    assert (rollout["slot"][0, 1:][ends[:-1]] == 0).all()
    assert torch.equal(rollout["step_count"].squeeze(-1), rollout["slot"])
    assert rollout["slot"][1].tolist() == list(range(40))
    assert rollout["state"][1].abs().max() == 0


@pytest.mark.parametrize("force", [float("nan"), 20.5, -float("inf")])
def test_a_bad_command_is_named(force):
    env = make(2)
    tensordict = env.reset().set("action", torch.tensor([[0.0], [force]]))
    with pytest.raises(ValueError, match=str(force)):
        env.step(tensordict)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"num_devices": 0}, "num_devices"),
        ({"num_devices": 2, "frame_history": 0}, "frame_history"),
        ({"num_devices": 2, "episode_length": 0}, "episode_length"),
        ({"num_devices": 2, "batch_size": [2, 3]}, "last batch dimension"),
        ({"num_devices": 2, "plant": {"sampling_interval": -1.0}}, "slot must be a positive"),
        ({"num_devices": 2, "plant": {"process_noise_std": (-1.0, 0.0)}}, "process_noise_std"),
    ],
)
def test_bad_arguments_are_refused(arguments, named):
    with pytest.raises(ValueError, match=named):
        make(**arguments)
