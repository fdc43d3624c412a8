"""Every plant, and one written from the docs page alone, in the fleet and in the chain."""

from __future__ import annotations

import dataclasses
import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from tsjepa.envs import FleetEnv, Radio, make_env, make_policy
from tsjepa.envs.make import check_fit
from tsjepa.models import Actor, Encoder, Predictor, SemanticController
from tsjepa.plants import CartPole, DoubleCartPole, MuJoCo, Pendulum, Reacher, Suite, build_plant, describe_plant
from tsjepa.radio import SCHEDULERS, gated

sys.path.insert(0, str(Path(__file__).parents[1] / "plants"))
import acrobot
import machines


def rotary(folder: Path) -> MuJoCo:
    (folder / "rotary.xml").write_text(machines.ROTARY)
    return MuJoCo(folder / "rotary.xml", 0.02, {"drive": [-0.3, 0.3]}, start={"pole": 0.1})


PLANTS = {
    "cart-pole": lambda folder: CartPole(set_point_step=0.5),
    "double cart-pole": lambda folder: DoubleCartPole(),
    "pendulum": lambda folder: Pendulum(),
    "reacher": lambda folder: Reacher(),
    "suite": lambda folder: Suite("walker", "walk", frame=(32, 64)),
    "mjcf": rotary,
    "acrobot": lambda folder: acrobot.Acrobot(),
}
any_plant = pytest.mark.parametrize("name", PLANTS)


def model_of(plant) -> SemanticController:
    """A small controller with random weights of the plant's sizes."""
    spec = plant.spec
    actor = Actor(spec.action_low, spec.action_high, 8, (16, 8), 0.0, spec.reference_low, spec.reference_high)
    encoder = Encoder(2, (4, 4, 4), 8, *spec.frame)
    return SemanticController(encoder, actor, 1, spec, Predictor(8, 16, action_dim=spec.action_dim)).eval()


@any_plant
def test_specs_of_the_fleet_and_of_the_chain(name, tmp_path):
    plant = PLANTS[name](tmp_path)
    check_env_specs(FleetEnv(plant, 2, episode_length=3, frame_history=2))
    check_env_specs(make_env(plant, 2, "round_robin", Radio(resource_blocks=1)))
    torch.manual_seed(0)
    check_env_specs(make_env(plant, 2, "max_age", Radio(resource_blocks=1), model_of(plant)))


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"slot": 0.01}, "a slot in seconds of 0.02, and the plant has 0.01"),
        ({"frame": (32, 64)}, "a frame of (64, 128), and the plant has (32, 64)"),
        ({"action_low": (-10.0,)}, "a smallest command of (-20.0,), and the plant has (-10.0,)"),
        ({"action_high": (10.0,)}, "a largest command of (20.0,), and the plant has (10.0,)"),
    ],
)
def test_a_model_of_another_machine_is_refused_with_both_values(changed, named):
    plant = CartPole()
    model = model_of(plant)
    check_fit(model, plant)
    plant.spec = dataclasses.replace(plant.spec, **changed)
    with pytest.raises(ValueError, match=re.escape(named)):
        check_fit(model, plant)


@any_plant
def test_a_model_drives_it_from_pixels_and_references(name, tmp_path):
    plant = PLANTS[name](tmp_path)
    torch.manual_seed(0)
    model = model_of(plant)
    env, policy = make_env(plant, 2, "oracle", controller=model), make_policy(plant, model)
    rollout = env.rollout(3, policy)
    spec = plant.spec
    assert rollout["pixels"].shape[2:] == (2, *spec.frame, 3) and rollout["pixels"].float().std() > 1
    assert rollout["action"].shape[2:] == (spec.action_dim,)
    with torch.no_grad():
        expected = model.act(model.encode(rollout["pixels"]), rollout.get("reference", None))
    torch.testing.assert_close(rollout["action"], expected, atol=1e-4, rtol=1e-4)
    assert (rollout.get("reference", None) is not None) == (spec.reference_dim > 0)


def test_the_acrobot_is_held_up_and_comes_back_from_plain_values():
    plant = acrobot.Acrobot()
    env, policy = make_env(plant, 8, slots=150), make_policy(plant)
    rollout = env.rollout(150, policy)
    assert not plant.failed(rollout["next", "state"]).any()
    assert rollout["next", "reward"][:, -50:].mean() > 0.8
    assert not make_policy(plant)(env.reset())["action"].isnan().any()
    again = build_plant(describe_plant(plant), trusted=True)
    assert type(again) is acrobot.Acrobot and np.array_equal(again.start_half_widths, plant.start_half_widths)
    with pytest.raises(ValueError, match="trusted=True"):
        build_plant(describe_plant(plant))


def test_the_page_and_the_plant_written_from_it_are_short():
    lines = Path(acrobot.__file__).read_text().splitlines()
    assert len(lines) <= 100 and "tsjepa.envs" not in "\n".join(lines)


@pytest.mark.parametrize("name", ["urgency", "first_contact", "expected_urgency", "genie", "whittle_cost"])
def test_a_scheduler_by_need_gets_what_it_needs_within_other_functions_too(name):
    radio = Radio(resource_blocks=2, snr_target_db=60.0)  # with every device above the threshold the gate does nothing
    plant, runs = CartPole(process_noise_std=0.008), []
    for scheduler in (name, partial(gated(SCHEDULERS[name]))):
        env = make_env(plant, 4, scheduler, radio, "linear", slots=20)
        runs.append(env.rollout(20, make_policy(plant, "linear")))
    assert torch.equal(runs[0]["scheduled"], runs[1]["scheduled"])
