"""Names and units of what a MuJoCo model's physics holds, for plants that nobody has named by hand."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

FREE, BALL, SLIDE, HINGE = (int(getattr(mujoco.mjtJoint, f"mjJNT_{kind}")) for kind in ("FREE", "BALL", "SLIDE", "HINGE"))
QUATERNION = [(part, "1") for part in ("qw", "qx", "qy", "qz")]
POSITION = [("x", "m"), ("y", "m"), ("z", "m")]
TURN = [("wx", "rad/s"), ("wy", "rad/s"), ("wz", "rad/s")]
COORDINATES = {FREE: POSITION + QUATERNION, BALL: QUATERNION, SLIDE: [("", "m")], HINGE: [("", "rad")]}
RATES = {
    FREE: [("x_dot", "m/s"), ("y_dot", "m/s"), ("z_dot", "m/s"), *TURN],
    BALL: TURN,
    SLIDE: [("dot", "m/s")],
    HINGE: [("dot", "rad/s")],
}


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """A joint's name, or its kind of place in the model where it has none."""
    return model.joint(joint).name or f"joint_{joint}"


def positions_of(model: mujoco.MjModel, joint: int) -> tuple[list[int], list[str], list[str]]:
    """Indices into the positions, names and units of one joint."""
    parts = COORDINATES[int(model.jnt_type[joint])]
    first, name = int(model.jnt_qposadr[joint]), joint_name(model, joint)
    return list(range(first, first + len(parts))), [_joined(name, part) for part, _ in parts], [unit for _, unit in parts]


def rates_of(model: mujoco.MjModel, joint: int) -> tuple[list[int], list[str], list[str]]:
    """Indices into the velocities, names and units of one joint."""
    parts = RATES[int(model.jnt_type[joint])]
    first, name = int(model.jnt_dofadr[joint]), joint_name(model, joint)
    return list(range(first, first + len(parts))), [_joined(name, part) for part, _ in parts], [unit for _, unit in parts]


def all_names(model: mujoco.MjModel) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of positions, then velocities [nq + nv]."""
    parts = [place(model, joint) for place in (positions_of, rates_of) for joint in range(model.njnt)]
    return tuple(name for part in parts for name in part[1]), tuple(unit for part in parts for unit in part[2])


def actuator_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the actuators."""
    return tuple(model.actuator(index).name or f"actuator_{index}" for index in range(model.nu))


def mean_pose(model: mujoco.MjModel, camera: int, positions: Sequence[float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Where a camera is and how it is turned (quaternion) with the joints at ``positions``, by default the model's own."""
    data = mujoco.MjData(model)
    if positions is not None:
        data.qpos[:] = positions
    mujoco.mj_forward(model, data)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, data.cam_xmat[camera])
    return data.cam_xpos[camera].copy(), quaternion


def _joined(name: str, part: str) -> str:
    return f"{name}_{part}" if part else name
