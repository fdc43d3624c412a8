"""What the plants change in dm_control's own models: all of it is named here, so that a new release shows."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torchrl  # noqa: F401  (before dm_control)
from dm_control import suite

from tsjepa.plants import CartPole, DoubleCartPole, Pendulum, Reacher

MOTOR = {"actuator_gear", "actuator_ctrlrange", "actuator_acc0"}
# what counts and sums up a body's geoms, and so follows from taking some of the world's out
COUNTS = {"body_geomadr", "body_geomnum", "body_bvhadr", "body_bvhnum", "body_contype", "body_conaffinity"}
MACHINES = {
    "cart-pole": (CartPole, ("cartpole", "balance"), ("floor", "rail1", "rail2"), ("rail",), MOTOR),
    "double cart-pole": (DoubleCartPole, ("cartpole", "two_poles"), ("floor", "rail1", "rail2"), ("rail",), MOTOR),
    "pendulum": (Pendulum, ("pendulum", "swingup"), ("floor",), (), set()),
    "reacher": (
        Reacher,
        ("reacher", "hard"),
        ("ground", "wall_x", "wall_y", "wall_neg_x", "wall_neg_y", "target"),
        (),
        set(),
    ),
}
machine = pytest.mark.parametrize("name", MACHINES)


def models(name: str) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """The suite's model and the plant's."""
    kind, task, *_ = MACHINES[name]
    return suite.load(*task, {"random": 0}).physics.model.ptr, kind().model


def geoms(model: mujoco.MjModel) -> list[str]:
    return [model.geom(index).name for index in range(model.ngeom)]


@machine
def test_bodies_joints_and_motors_are_the_suites_but_for_the_motors_unit(name):
    stock, ours = models(name)
    *_, expected = MACHINES[name]
    arrays = [part for part in dir(stock) if isinstance(getattr(stock, part), np.ndarray)]
    mechanical = [part for part in arrays if part.startswith(("body_", "jnt_", "dof_", "actuator_", "qpos"))]
    assert len(mechanical) > 80
    changed = {part for part in mechanical if not np.array_equal(getattr(stock, part), getattr(ours, part))}
    assert changed - COUNTS == expected
    assert ours.opt.gravity.tolist() == stock.opt.gravity.tolist() == [0.0, 0.0, -9.81]
    for part in ("integrator", "disableflags", "solver", "cone"):
        assert getattr(ours.opt, part) == getattr(stock.opt, part), part


@pytest.mark.parametrize("name", ["cart-pole", "double cart-pole"])
def test_the_motors_command_is_the_force(name):
    stock, ours = models(name)
    assert (stock.actuator_gear[0, 0], ours.actuator_gear[0, 0]) == (10.0, 1.0)
    assert (stock.actuator_ctrlrange.tolist(), ours.actuator_ctrlrange.tolist()) == ([[-1.0, 1.0]], [[-20.0, 20.0]])


@machine
def test_what_is_hidden_from_the_camera_is_named_and_the_rest_has_its_shape(name):
    stock, ours = models(name)
    _, _, hidden, added, _ = MACHINES[name]
    assert [geom for geom in geoms(stock) if geom not in hidden] == [geom for geom in geoms(ours) if geom not in added]
    assert set(hidden) <= set(geoms(stock)) and set(added) <= set(geoms(ours))
    for geom in set(geoms(ours)) - set(added):
        for part in ("size", "type", "pos", "quat", "rgba"):
            np.testing.assert_array_equal(getattr(ours.geom(geom), part), getattr(stock.geom(geom), part))


@machine
def test_textures_go_and_there_is_one_camera(name):
    stock, ours = models(name)
    assert (stock.ntex, ours.ntex) == (2, 0)
    assert [ours.camera(index).name for index in range(ours.ncam)] == ["view"]
    assert ours.nmat == stock.nmat
    np.testing.assert_array_equal(ours.mat_rgba, stock.mat_rgba)
    assert ours.opt.enableflags == 0
    quality = ours.vis.quality
    assert (quality.numslices, quality.numstacks, quality.numquads) == (12, 4, 1)
    light = ours.vis.headlight
    assert [light.ambient[0], light.diffuse[0], light.specular[0]] == pytest.approx([0.4, 0.8, 0.1])


@pytest.mark.parametrize("name", ["pendulum", "reacher"])
def test_torques_are_the_suites(name):
    stock, ours = models(name)
    np.testing.assert_array_equal(ours.actuator_gear, stock.actuator_gear)
    np.testing.assert_array_equal(ours.actuator_ctrlrange, stock.actuator_ctrlrange)
