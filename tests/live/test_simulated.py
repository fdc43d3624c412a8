"""The plant of a device is the chain's: same starts, same pictures, same scores."""

import numpy as np
import pytest
import torch

from tsjepa.envs.fleet import FleetEnv
from tsjepa.envs.transforms import Camera
from tsjepa.live.simulated import SimulatedPlants
from tsjepa.plants import CartPole, build_plant
from tsjepa.support.seeds import HELD_OUT

PLANT = {"class_path": "tsjepa.plants.CartPole", "init_args": {"process_noise_std": 0.05}}
SEED, SLOTS, HISTORY = 3, 12, 4


def commands(slot: int, devices: int) -> np.ndarray:
    return np.float32(np.random.default_rng(slot).uniform(-20, 20, (devices, 1)))


@pytest.mark.parametrize(("stack", "spacing"), [(2, 1), (2, 3), (1, 1)])
def test_states_and_pictures_are_those_of_the_chain(stack, spacing):
    plant = build_plant(PLANT)
    fleet = FleetEnv(plant, 3, SLOTS, HISTORY, HELD_OUT + SEED, terminate_on_failure=False)
    camera = Camera(plant.render, plant.spec.frame, stack, spacing)
    mine = SimulatedPlants(PLANT, np.arange(3), SEED, SLOTS, HISTORY, stack, spacing)
    for _ in range(2):  # episodes
        now, score, down = fleet.reset(), np.zeros(3), np.zeros(3, bool)
        for slot in range(SLOTS):
            assert np.array_equal(mine.state.astype(np.float32), now["state"].numpy())
            pictures = camera._slot({}, now, None)["pixels"].numpy()
            assert np.array_equal(mine.look(), pictures)
            force = commands(slot, 3)
            ended = mine.act(force)
            now = fleet.step(now.set("action", torch.from_numpy(force)))["next"]
            down |= plant.failed(now["state"].numpy())
            score += np.where(down, 0, now["reward"][:, 0].numpy())
            assert ended == (slot == SLOTS - 1)
        assert list(mine.scores)[-3:] == pytest.approx((score / SLOTS).tolist())
    assert mine.summary()["episodes"] == 6


def test_a_device_has_the_same_plant_in_whatever_process():
    one = SimulatedPlants(PLANT, np.array([2]), SEED, None, 1, 2, 1)
    three = SimulatedPlants(PLANT, np.arange(3), SEED, None, 1, 2, 1)
    for slot in range(4):
        force = commands(slot, 3)
        one.act(force[2:])
        three.act(force)
    assert np.array_equal(one.state[0], three.state[2])


def test_nothing_counts_from_a_fall_on():
    mine = SimulatedPlants(PLANT, np.arange(2), SEED, None, 1, 2, 1)
    for _ in range(100):
        mine.act(np.full((2, 1), 20.0, np.float32))  # drives against the end of the rail
    summary = mine.summary()
    assert summary["fallen"] == 2
    assert summary["raw_score"] < 0.2
    assert bool(CartPole().failed(mine.state).all())


def test_an_episode_has_slots():
    with pytest.raises(ValueError, match="episode_slots is 0"):
        SimulatedPlants(PLANT, np.arange(1), SEED, 0, 1, 2, 1)
