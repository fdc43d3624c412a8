"""A Gymnasium environment as a plant; skipped where gymnasium is not installed."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch
from torch import nn

from tsjepa.plants import Gym, build_plant, describe_plant

gymnasium = pytest.importorskip("gymnasium", reason="needs the optional package gymnasium")
from gymnasium.envs.classic_control import PendulumEnv  # noqa: E402 - where it is installed


class Drawn(PendulumEnv):
    """Gymnasium's pendulum with a picture of its own, so that pygame need not be there."""

    def render(self) -> np.ndarray:
        rows, columns = np.mgrid[-1:1:100j, -1:1:100j]
        at = np.sin(self.state[0]), -np.cos(self.state[0])
        near = (columns - 0.7 * at[0]) ** 2 + (rows - 0.7 * at[1]) ** 2 < 0.05
        return np.repeat(np.uint8(40 + 200 * near)[..., None], 3, axis=-1)


class Split(Drawn):
    """One that observes a dictionary."""

    def __init__(self, render_mode: str | None = None) -> None:
        super().__init__(render_mode)
        self.observation_space = gymnasium.spaces.Dict({"place": self.observation_space})


gymnasium.register("Drawn-v0", Drawn)
gymnasium.register("Split-v0", Split)
ROWS, FIRST, ZERO = np.arange(3), np.zeros(3, np.int64), np.zeros((3, 1))


@pytest.fixture
def plant() -> Gym:
    return Gym("Drawn-v0", reward=(-16.3, 0.0), frame=(32, 48))


def test_it_steps_as_gymnasium_does(plant):
    physics = plant.start(7, ROWS, FIRST)
    env = gymnasium.make("Drawn-v0")
    env.reset(seed=0)
    env.unwrapped.state = [np.arctan2(physics[0, 1], physics[0, 0]), physics[0, 2]]
    for slot in range(5):
        physics = plant.advance(physics, np.full((3, 1), 0.7), 7, ROWS, FIRST, FIRST + slot)
        observation, reward, *_ = env.step(np.array([0.7], np.float32))
        np.testing.assert_allclose(physics[0, :3], observation, atol=1e-5)
        assert plant.score(physics)[0] == pytest.approx((reward + 16.3) / 16.3, abs=1e-5)
    assert not plant.failed(physics).any()


def test_starts_belong_to_seed_device_and_episode(plant):
    starts = plant.start(7, ROWS, FIRST)
    np.testing.assert_array_equal(plant.start(7, ROWS[1:2], FIRST[1:2])[0], starts[1])
    assert (plant.start(8, ROWS, FIRST)[:, 0] != starts[:, 0]).all()
    assert (plant.start(7, ROWS, FIRST + 1)[:, 0] != starts[:, 0]).all()


def test_it_cannot_branch_and_says_so(plant):
    before = plant.start(7, ROWS, FIRST)
    plant.advance(before, ZERO, 7, ROWS, FIRST, FIRST)
    with pytest.raises(ValueError, match="can only go on from where it is"):
        plant.advance(before, ZERO, 7, ROWS, FIRST, FIRST)


def test_the_scene_is_the_picture(plant):
    physics = plant.start(7, ROWS, FIRST)
    pictures = plant.render(plant.scene(physics, 7, ROWS, FIRST))
    assert pictures.shape == (3, 32, 48, 3) and pictures.dtype == np.uint8 and pictures.std() > 10


def test_a_policy_sees_the_observation_only():
    class First(nn.Module):
        def forward(self, state):
            assert state.shape[1] == 3
            return state[:, 2:]

    plant = Gym("Drawn-v0", expert=First())
    assert plant.experts()["expert"](torch.tensor([1.0, 0.0, 0.5, 0.9, 0.0])).item() == 0.5


def test_it_comes_back_from_plain_values(plant):
    again = build_plant(describe_plant(plant))
    assert again.spec == plant.spec and again.reward == (-16.3, 0.0)


def test_rewards_that_are_no_range_are_refused():
    with pytest.raises(ValueError, match=r"reward is \[1.0, 1.0\]"):
        Gym("Drawn-v0", reward=(1.0, 1.0))


@pytest.mark.parametrize(
    ("name", "said"),
    [("CartPole-v1", "Discrete"), ("Chariot-v0", "cannot be made"), ("Split-v0", "FlattenObservation")],
)
def test_what_cannot_be_is_said(name, said):
    with pytest.raises(ValueError, match=said):
        Gym(name)


def test_without_gymnasium_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'tsjepa\[gym\]'"):
        Gym("Drawn-v0")
