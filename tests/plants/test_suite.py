"""Any task of the dm_control suite: its starts, its reward, its pictures, and experts from a file."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch
import torchrl  # noqa: F401  (before dm_control)
from dm_control import suite
from torch import nn

from tsjepa.plants import Suite, build_plant, describe_plant

ROWS, FIRST = np.arange(3), np.zeros(3, np.int64)


class Half(nn.Module):
    """A policy of one parameter."""

    def __init__(self, gain: float = 0.5) -> None:
        super().__init__()
        self.gain = gain

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        return self.gain * state[:, :1]


@pytest.fixture(scope="module")
def acrobot() -> Suite:
    return Suite("acrobot", "swingup", frame=(32, 48))


def test_the_spec_is_the_tasks(acrobot):
    spec, environment = acrobot.spec, suite.load("acrobot", "swingup")
    assert spec.state_names == ("shoulder", "elbow", "shoulder_dot", "elbow_dot")
    assert spec.state_units == ("rad", "rad", "rad/s", "rad/s")
    assert spec.slot == environment.control_timestep() and spec.frame == (32, 48)
    assert (spec.action_low, spec.action_high, spec.action_names) == ((-1.0,), (1.0,), ("elbow",))


def test_starts_are_the_tasks_own_and_belong_to_seed_device_and_episode(acrobot):
    starts = acrobot.start(5, ROWS, FIRST)
    np.testing.assert_array_equal(acrobot.start(5, ROWS[1:2], FIRST[:1]), starts[1:2])
    for other in (acrobot.start(6, ROWS, FIRST), acrobot.start(5, ROWS + 3, FIRST), acrobot.start(5, ROWS, FIRST + 1)):
        assert (other[:, :2] != starts[:, :2]).all()
    angles = acrobot.start(0, np.arange(200), np.zeros(200, np.int64))[:, :2]
    assert np.abs(angles).max() <= np.pi and np.abs(angles).max() > 3  # the whole circle, as the task draws it


def test_the_score_is_the_tasks_reward(acrobot):
    environment = suite.load("acrobot", "swingup")
    states = np.array([[0.0, 0.0, 0.0, 0.0], [3.0, 0.1, 1.0, -1.0], [0.1, -0.05, 0.0, 0.0]])
    expected = []
    for state in states:
        with environment.physics.reset_context():
            environment.physics.data.qpos[:], environment.physics.data.qvel[:] = state[:2], state[2:]
        expected.append(environment.task.get_reward(environment.physics))
    assert expected[0] == 1.0 and expected[1] < 0.1
    np.testing.assert_allclose(acrobot.score(states), expected)
    tensor = acrobot.score(torch.from_numpy(states).reshape(3, 1, 4))
    assert tensor.shape == (3, 1)
    np.testing.assert_allclose(tensor.flatten(), expected)
    assert not acrobot.failed(states).any()


def test_pictures_move_with_the_machine_and_a_copy_draws_the_same(acrobot):
    physics = np.array([[0.0, 0.0, 0.0, 0.0], [1.5, 0.5, 0.0, 0.0]])
    scene = acrobot.scene(physics, 0, ROWS[:2], FIRST[:2])
    pictures = acrobot.render(scene)
    assert pictures.shape == (2, 32, 48, 3) and (pictures[0] != pictures[1]).any()
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(acrobot)).render(scene), pictures)


def test_without_an_expert_the_command_rests(acrobot):
    (rest,) = acrobot.experts().values()
    assert rest(torch.ones(2, 3, 4)).shape == (2, 3, 1) and not rest(torch.ones(4)).any()


def test_a_task_with_activations_and_a_following_camera_runs():
    plant = Suite("quadruped", "walk")
    physics = plant.start(0, ROWS[:1], FIRST[:1])
    assert physics.shape[1] == plant.model.nq + plant.model.nv + plant.model.na > plant.spec.state_dim
    after = plant.advance(physics, np.full((1, 12), 0.2), 0, ROWS[:1], FIRST[:1], FIRST[:1])
    assert np.isfinite(after).all() and 0 <= plant.score(plant.state(after))[0] <= 1
    assert plant.model.cam_mode[0] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("reacher", "easy"), "draws part of its model"),
        (("acrobot", "fly"), "no task 'acrobot', 'fly'; acrobot has swingup, swingup_sparse"),
        (("chariot", "race"), "the domains are acrobot, ball_in_cup"),
        (("acrobot", "swingup", None, (64, 64), "nose"), "no camera 'nose'; the model has fixed, lookat"),
    ],
)
def test_what_cannot_be_is_said(arguments, said):
    with pytest.raises(ValueError, match=said):
        Suite(*arguments)


def test_a_module_by_class_path_is_the_expert_where_it_is_trusted():
    description = {
        "class_path": "tsjepa.plants.Suite",
        "init_args": {
            "domain": "acrobot",
            "task": "swingup",
            "expert": {"class_path": f"{Half.__module__}.Half", "init_args": {"gain": 0.25}},
        },
    }
    with pytest.raises(ValueError, match="trusted=True"):
        build_plant(description)
    plant = build_plant(description, trusted=True)
    assert plant.experts()["expert"](torch.tensor([[2.0, 0.0, 0.0, 0.0]])).item() == 0.5
    assert plant.experts()["expert"](torch.tensor([20.0, 0.0, 0.0, 0.0])).item() == 1.0  # within the actuator's range
    assert describe_plant(plant)["init_args"]["expert"] == description["init_args"]["expert"]


@pytest.mark.parametrize("kind", ["jit", "export"])
def test_a_policy_file_is_the_expert(kind, tmp_path):
    path = tmp_path / ("policy.pt" if kind == "jit" else "policy.pt2")
    example = torch.zeros(2, 4)
    if kind == "jit":
        torch.jit.save(torch.jit.trace(Half(), example), path)
    else:
        batch = {0: torch.export.Dim("batch")}
        torch.export.save(torch.export.export(Half(), (example,), dynamic_shapes=(batch,)), path)
    plant = Suite("acrobot", "swingup", expert=path)
    states = torch.tensor(
        [[[1.0, 0.0, 0.0, 0.0]], [[-0.5, 0.0, 0.0, 0.0]], [[9.0, 0.0, 0.0, 0.0]]], dtype=torch.float64
    )
    command = plant.experts()["expert"](states)
    assert command.dtype == torch.float64 and command.flatten().tolist() == [0.5, -0.25, 1.0]
    again = build_plant(describe_plant(plant))
    assert torch.equal(again.experts()["expert"](states), command)


def test_a_file_that_is_no_policy_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match="no policy"):
        Suite("acrobot", "swingup", expert=str(tmp_path / "absent.pt"))
    (tmp_path / "text.pt").write_text("hello")
    with pytest.raises(ValueError, match="is no policy"):
        Suite("acrobot", "swingup", expert=str(tmp_path / "text.pt"))
    two = Suite("acrobot", "swingup", expert=nn.Linear(4, 2))
    with pytest.raises(ValueError, match=r"gave \[1, 2\] for 1 states and 1 commands"):
        two.experts()["expert"](torch.zeros(4))
