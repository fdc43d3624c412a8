"""Names and units of what a MuJoCo model's physics holds, for plants that nobody has named by hand."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

FREE, BALL, SLIDE, HINGE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{kind}")) for kind in ("FREE", "BALL", "SLIDE", "HINGE")
)
Table = dict[int, list[tuple[str, str]]]
_PLACE = [("x", "m"), ("y", "m"), ("z", "m")]
_QUATERNION = [("qw", "1"), ("qx", "1"), ("qy", "1"), ("qz", "1")]
_TURN = [("rx", "rad"), ("ry", "rad"), ("rz", "rad")]
_SPIN = [("wx", "rad/s"), ("wy", "rad/s"), ("wz", "rad/s")]
_MOTION = [("x_dot", "m/s"), ("y_dot", "m/s"), ("z_dot", "m/s")]
# of each kind of joint: its positions; its displacement from a pose, one number a degree of freedom; its rates
POSITIONS: Table = {FREE: _PLACE + _QUATERNION, BALL: _QUATERNION, SLIDE: [("", "m")], HINGE: [("", "rad")]}
DISPLACEMENTS: Table = {FREE: _PLACE + _TURN, BALL: _TURN, SLIDE: [("", "m")], HINGE: [("", "rad")]}
RATES: Table = {FREE: _MOTION + _SPIN, BALL: _SPIN, SLIDE: [("dot", "m/s")], HINGE: [("dot", "rad/s")]}


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Names of the joints; those without one are counted."""
    return [model.joint(index).name or f"joint_{index}" for index in range(model.njnt)]


def names_of(model: mujoco.MjModel, *tables: Table) -> tuple[list[str], list[str], list[str]]:
    """Names, units and joints of the numbers that ``tables`` list for each joint, one table after the other."""
    joints = joint_names(model)
    parts = [
        (f"{joints[index]}_{part}" if part else joints[index], unit, joints[index])
        for table in tables
        for index in range(model.njnt)
        for part, unit in table[int(model.jnt_type[index])]
    ]
    names, units, owners = zip(*parts, strict=True) if parts else ((), (), ())
    return list(names), list(units), list(owners)


def actuator_names(model: mujoco.MjModel) -> list[str]:
    """Names of the actuators; those without one are counted."""
    return [model.actuator(index).name or f"actuator_{index}" for index in range(model.nu)]


def camera_pose(
    model: mujoco.MjModel, camera: int, positions: Sequence[float] | np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Where a camera is [3] and how it is turned [4] with the joints at ``positions``, by default the model's own."""
    data = mujoco.MjData(model)
    if positions is not None:
        data.qpos[:] = positions
    mujoco.mj_forward(model, data)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, data.cam_xmat[camera])
    return data.cam_xpos[camera].copy(), quaternion
