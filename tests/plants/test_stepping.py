"""The stepping of many copies against stock dm_control, and the split of a slot into physics steps."""

from __future__ import annotations

import numpy as np
import pytest
import torchrl  # noqa: F401  (before dm_control)
from dm_control.suite import cartpole

from tsjepa.plants import CartPole
from tsjepa.plants.stepping import substeps


def stock_trajectory(start: np.ndarray, forces: np.ndarray, steps: int, timestep: float) -> np.ndarray:
    """dm_control's own cart-pole, whose motor multiplies ctrl by 10, at the same timestep."""
    physics = cartpole.Physics.from_xml_string(*cartpole.get_model_and_assets())
    physics.model.opt.timestep = timestep
    with physics.reset_context():
        physics.data.qpos[:], physics.data.qvel[:] = start[:2], start[2:]
    states = []
    for force in forces:
        physics.set_control([force / 10.0])
        physics.step(steps)
        states.append(np.concatenate([physics.data.qpos, physics.data.qvel]))
    return np.array(states)


@pytest.mark.parametrize("slot", [0.001, 0.02, 0.05])
@pytest.mark.parametrize("start", [(0.1, -0.2, 0.3, 0.1), (1.7, 0.3, 1.5, 0.0)], ids=["free", "hits the rail's end"])
def test_force_in_newtons_gives_the_stock_trajectory(slot, start):
    forces = np.random.default_rng(0).uniform(-10, 10, 40)
    stepper, (steps, timestep) = CartPole(slot).stepper, substeps(slot)
    state, ours = np.array([start]), []
    for force in forces:
        state = stepper.advance(state, np.array([[force]]))
        ours.append(state[0])
    np.testing.assert_allclose(ours, stock_trajectory(np.array(start), forces, steps, timestep), atol=1e-7)


def test_forces_up_to_20_newtons_reach_the_plant():
    speed = CartPole(0.001).stepper.advance(np.zeros((3, 4)), np.array([[5.0], [10.0], [20.0]]))[:, 2]
    np.testing.assert_allclose(speed / speed[0], [1.0, 2.0, 4.0], rtol=1e-3)


def test_a_row_does_not_depend_on_the_others():
    states = np.random.default_rng(1).uniform(-0.3, 0.3, (7, 4))
    forces = np.random.default_rng(2).uniform(-20, 20, (7, 1))
    together = CartPole().stepper.advance(states, forces)
    alone = CartPole().stepper
    for row in (6, 2):
        np.testing.assert_array_equal(alone.advance(states[row : row + 1], forces[row : row + 1])[0], together[row])


@pytest.mark.parametrize(("slot", "steps"), [(0.001, 1), (0.002, 1), (0.003, 2), (0.02, 10), (0.05, 25)])
def test_substeps_are_at_most_2_ms_and_fill_the_slot(slot, steps):
    assert substeps(slot) == (steps, pytest.approx(slot / steps))


def test_a_model_that_wants_shorter_steps_has_them():
    assert substeps(0.02, 0.00025) == (80, pytest.approx(0.00025))


@pytest.mark.parametrize("slot", [0.0, -0.02, float("nan"), float("inf")])
def test_an_impossible_interval_is_refused(slot):
    with pytest.raises(ValueError, match="sampling_interval"):
        substeps(slot)
