"""A stranger's MJCF as a plant: balanced by its regulator, or the sentence that says why it cannot be."""

from __future__ import annotations

import json

import machines
import numpy as np
import pytest
import scipy.linalg
import torch
import yaml
from drive import run
from recordings import WILD as WILD_FILES

from tsjepa.cli import main
from tsjepa.plants import MuJoCo, build_plant, describe_plant
from tsjepa.plants.equilibrium import balancing_gain

WILD = WILD_FILES / "models" / "two-wheeler" / "src" / "simulation"
LIMITS = {
    "start": {"pole": 0.1, "arm": 0.3},
    "score": {"pole": 0.05, "arm": 0.1},
    "failure": {"pole": 0.8, "arm": 2.0},
}


@pytest.fixture
def machine(tmp_path):
    """Makes a plant of one of the files."""

    def make(xml: str = machines.ROTARY, **arguments) -> MuJoCo:
        (tmp_path / "machine.xml").write_text(xml)
        settings = {"xml": tmp_path / "machine.xml", "slot": 0.02, "action": {"drive": [-0.3, 0.3]}} | arguments
        return MuJoCo(**settings)

    return make


def test_a_rotary_pendulum_is_balanced_by_its_regulator(machine):
    plant = machine(**LIMITS)
    assert plant.spec.state_names == ("arm", "pole", "arm_dot", "pole_dot")
    assert plant.spec.state_units == ("rad", "rad", "rad/s", "rad/s")
    score, failed, final = run(plant, 150, count=50)
    assert failed == 0 and score > 0.6 and np.abs(final).max() < 0.05
    plant.expert.gain.zero_()
    assert run(plant, 150, count=50)[1] == 50


def test_its_linear_model_predicts_small_motions(machine):
    plant = machine(**LIMITS)
    a, b = (part.numpy() for part in plant.linear())
    generator = np.random.default_rng(0)
    state, action = 1e-3 * generator.normal(size=(5, 4)), 1e-3 * generator.normal(size=(5, 1))
    zero = np.zeros(5, np.int64)
    after = plant.state(plant.advance(plant.coordinates.physics(state), action, 0, zero, zero, zero))
    np.testing.assert_allclose(after, state @ a.T + action @ b.T, atol=2e-6)
    assert np.abs(np.linalg.eigvals(a)).max() > 1.05


def test_sensors_may_be_the_state(machine):
    sensors = ["arm_encoder", "pole_encoder", "arm_tacho", "pole_tacho"]
    by_joint = machine(**LIMITS)
    score = {"pole_encoder": 0.05, "arm_encoder": 0.1}
    plant = machine(
        state=sensors, start=LIMITS["start"], score=score, failure={"pole_encoder": 0.8, "arm_encoder": 2.0}
    )
    assert plant.spec.state_names == tuple(sensors) and set(plant.spec.state_units) == {"unknown"}
    for ours, expected in zip(plant.linear(), by_joint.linear(), strict=True):
        torch.testing.assert_close(ours, expected, atol=1e-6, rtol=1e-6)
    assert run(plant, 100, count=20)[1] == 0


def test_a_turn_is_three_numbers_and_is_balanced(machine):
    action = {"roll": [-0.5, 0.5], "tilt": [-0.5, 0.5]}
    plant = machine(
        machines.TOP, action=action, start={"foot_rx": 0.05, "foot_ry": 0.05}, failure={"foot_rx": 0.7, "foot_ry": 0.7}
    )
    assert plant.spec.state_names[:5] == ("foot_rx", "foot_ry", "foot_rz", "roll", "tilt")
    physics = plant.start(0, np.arange(4), np.zeros(4, np.int64))
    np.testing.assert_allclose(np.linalg.norm(physics[:, :4], axis=1), 1.0)
    # a small turn about x is twice the quaternion's second number
    np.testing.assert_allclose(plant.state(physics)[:, 0], 2 * physics[:, 1], atol=1e-4)
    _, failed, final = run(plant, 100, count=20)
    assert failed == 0 and np.abs(final[:, :2]).max() < 0.02


def test_the_pose_may_be_a_keyframe_and_counts_as_zero(machine):
    plant = machine(pose="hanging", expert="lqr", start={"pole": 0.1})
    assert plant.coordinates.pose[1] == pytest.approx(np.pi)
    still = plant.coordinates.physics(np.zeros((1, 4)))
    assert still[0, 1] == pytest.approx(np.pi) and not plant.state(still).any()
    assert np.abs(np.linalg.eigvals(plant.linear()[0].numpy())).max() < 1.001


@pytest.mark.parametrize(
    ("xml", "arguments", "said"),
    [
        (
            machines.ROTARY,
            {"pose": "tilted"},
            "no equilibrium: .*at 0, pole_dot changes by .*give a pose",
        ),
        (machines.ROTARY, {"pose": {"pole": 0.3}}, "no equilibrium"),
        (machines.FALLING, {"action": {"lid": [-1, 1]}}, "in the air and falls: give settle"),
        (machines.UNDRIVEN, {}, r"not controllable: other(_dot)? grows 1\.\d+-fold in a slot, and no command"),
        (machines.ROTARY, {"state": ["arm"]}, "they depend on pole too; add it to state"),
        (
            machines.ROTARY,
            {"state": ["wheel"]},
            "state names wheel; .* the joints arm, pole and the sensors arm_",
        ),
        (machines.ROTARY, {"action": {"motor": [-1, 1]}}, "action names motor; the model has drive"),
        (machines.ROTARY, {"action": {}}, "action names no actuator; the model has drive"),
        (machines.ROTARY, {"action": {"drive": [0, 0]}}, "leave a range"),
        (machines.ROTARY, {"score": {"bar": 1.0}}, "score names bar; there are arm, pole, arm_dot, pole_dot"),
        (machines.ROTARY, {"failure": {"pole": -1.0}}, "have to be positive"),
        (machines.ROTARY, {"camera": "top"}, "no camera 'top'; the model has side"),
        (machines.ROTARY, {"integrator": "Heun"}, "no integrator 'Heun'"),
        (machines.ROTARY, {"pose": "sitting"}, "no keyframe 'sitting'; the model has hanging, tilted"),
        ("<mujoco><worldbody><geom/></worldbody></mujoco>", {}, "MuJoCo cannot read .*machine.xml"),
        ("hello", {}, "MuJoCo cannot read"),
    ],
)
def test_why_it_cannot_be_is_one_sentence(machine, xml, arguments, said):
    with pytest.raises(ValueError, match=said) as raised:
        machine(xml, **arguments)
    assert "\n" not in str(raised.value)


def test_an_absent_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no model"):
        MuJoCo(tmp_path / "absent.xml", 0.02, {"drive": [-1, 1]})


def test_what_has_no_regulator_is_a_plant_without_one(machine):
    plant = machine(machines.FALLING, action={"lid": [-1, 1]}, expert=None)
    _, failed, final = run(plant, 5, count=2)
    assert failed == 0 and final[0, 2] < -0.01  # it falls
    settled = machine(machines.FALLING, action={"lid": [-1, 1]}, settle=2.0)
    assert run(settled, 5, count=2)[0] == 1.0


def test_a_regulator_leaves_alone_what_rests_and_cannot_be_moved():
    a = torch.tensor([[1.1, 0.3, 0.2], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]], dtype=torch.float64)
    b = torch.tensor([[1.0], [0.0], [0.0]], dtype=torch.float64)
    gain = balancing_gain(a, b, (1.0, 1.0, 1.0), (1.0,), ["x", "y", "z"])
    cost = scipy.linalg.solve_discrete_are(a[:1, :1].numpy(), b[:1].numpy(), [[1.0]], [[1.0]])
    torch.testing.assert_close(gain[0, 0].item(), float(cost[0, 0] * 1.1 / (1 + cost[0, 0])))
    assert gain[0, 1:].abs().max() < 1e-9
    with pytest.raises(ValueError, match=r"z grows 1\.5-fold"):
        balancing_gain(a + torch.diag(torch.tensor([0.0, 0.0, 1.0])), b, (1.0,) * 3, (1.0,), ["x", "y", "z"])


@pytest.mark.parametrize("camera", ["auto", "side"])
def test_the_camera_sees_what_moves(machine, camera):
    plant = machine(**LIMITS, camera=camera, frame=(64, 64))
    poses = np.zeros((5, 4))
    poses[1:, :2] = [(0.3, 0), (0, 0.3), (1.5, 0.7), (-1.5, -0.7)]
    pictures = plant.render(plant.scene(plant.coordinates.physics(poses), 0, *np.zeros((2, 5), np.int64))).astype(int)
    assert all((picture != pictures[0]).any() for picture in pictures[1:])
    background = np.median(pictures, axis=0)
    if camera == "auto":
        shown = np.abs(pictures - background).max(-1) > 30
        border = np.concatenate([shown[:, 0], shown[:, -1], shown[:, :, 0], shown[:, :, -1]], axis=1)
        assert not border.any()  # all of it
        assert (pictures[0].max(-1) > 60).sum() > 40  # and from near


def test_it_comes_back_from_plain_values(machine):
    plant = machine(**LIMITS, integrator="RK4", camera="side")
    again = build_plant(describe_plant(plant))
    assert again.spec == plant.spec and torch.equal(again.expert.gain, plant.expert.gain)
    assert describe_plant(again) == describe_plant(plant)


TWO_WHEELS = {
    "slot": 0.02,
    "action": {"motor_l_wheel": [-40, 40], "motor_r_wheel": [-40, 40]},
    "start": {"robot_body_joint_rx": 0.1},
    "score": {"robot_body_joint_rx": 0.05},
    "failure": {"robot_body_joint_rx": 0.8, "robot_body_joint_y": 1.0},
}
wild = pytest.mark.skipif(not WILD.is_dir(), reason="the robot of ../shared/wild is not here")


@wild
def test_the_two_wheeler_is_refused_in_sentences_that_say_what_to_give():
    with pytest.raises(ValueError, match=r"material 'wheel_material' not found.*If another file includes this one"):
        MuJoCo(WILD / "robot-02.xml", **TWO_WHEELS)
    with pytest.raises(ValueError, match="in the air and falls: give settle"):
        MuJoCo(WILD / "scene.xml", **TWO_WHEELS)


@wild
@pytest.mark.slow
def test_the_two_wheeler_is_balanced_once_it_stands_on_its_wheels():
    plant = MuJoCo(WILD / "scene.xml", **TWO_WHEELS, settle=0.5)
    assert plant.spec.state_dim == 16
    score, failed, final = run(plant, 60, count=4)
    assert failed == 0 and score > 0.8 and np.abs(final[:, 3]).max() < 0.02
    assert run(MuJoCo(WILD / "scene.xml", **TWO_WHEELS, settle=0.5, expert=None), 60, count=4)[1] == 4  # left alone


@wild
@pytest.mark.slow
def test_the_two_wheeler_needs_no_python(tmp_path):
    """A recipe is all: the command line balances it over the chain."""
    plant = {"class_path": "tsjepa.plants.MuJoCo",
             "init_args": {"xml": str(WILD / "scene.xml"), **TWO_WHEELS, "settle": 0.5}}  # fmt: skip
    recipe = {"plant": plant, "num_devices": 2, "schedulers": ["round_robin"], "seeds": 2, "slots": 40, "video": False,
              "radio": {"resource_blocks": 2, "lossless": True}, "output": str(tmp_path / "fleet")}  # fmt: skip
    (tmp_path / "two-wheeler.yaml").write_text(yaml.safe_dump(recipe))
    assert main(["simulate", "--config", str(tmp_path / "two-wheeler.yaml")]) == 0
    (result,) = json.loads((tmp_path / "fleet" / "fleet.json").read_text())["schedulers"]
    assert result["failed_share"] == 0 and result["normalized_score"] > 0.9
