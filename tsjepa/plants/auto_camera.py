"""A camera for a model that nobody has placed one for: it stands where what moves shows best, and all of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from tsjepa.plants.joints import DISPLACEMENTS, FREE, HINGE, SLIDE, camera_pose, names_of
from tsjepa.plants.lens import CORNERS, View
from tsjepa.plants.renderer import moving_geoms

FOVY = 25.0  # degrees
# Candidates, the plainest first: a later one has to show more.
DIRECTIONS = list(itertools.product((0.0, 20.0, 45.0, 90.0), (0.0, 90.0, 45.0)))  # pitch, yaw
ALL_ROUND = math.pi / 2  # rad, how far a joint without limits is taken to turn
NUDGE = 1e-3  # m or rad
MARGIN = 1.1  # of what is seen around what has to be


def named_view(model: mujoco.MjModel, camera: str | int, positions: Sequence[float] | np.ndarray | None = None) -> View:
    """One of the model's own cameras, as it stands with the joints at ``positions``.

    Raises:
        ValueError: the model has no such camera.
    """
    names = [model.camera(index).name for index in range(model.ncam)]
    if camera not in names and camera not in range(model.ncam):
        raise ValueError(f"There is no camera {camera!r}; the model has {', '.join(names) or 'none'}.")
    index = names.index(camera) if camera in names else int(camera)
    position, quaternion = camera_pose(model, index, positions)
    return View(tuple(position.tolist()), float(model.cam_fovy[index]), orientation=tuple(quaternion.tolist()))


def visited(model: mujoco.MjModel, pose: np.ndarray, limits: Mapping[str, float]) -> np.ndarray:
    """Poses [P, nq] to show: ``pose``, and each joint's ends, by ``limits``, its own range, or a guess.

    A machine that is free to go anywhere is shown as far as it is large, so that it fills a part of the picture.
    """
    poses, names = [pose], names_of(model, DISPLACEMENTS)[0]
    corners = _corners(model, mujoco.MjData(model), moving_geoms(model), pose)
    size = float((corners.max(0) - corners.min(0)).max())
    for dof, name in enumerate(names):
        joint, kind = int(model.dof_jntid[dof]), int(model.jnt_type[model.dof_jntid[dof]])
        slides = kind == SLIDE or (kind == FREE and dof - model.jnt_dofadr[joint] < 3)
        most = size if slides else ALL_ROUND
        ends = (-most, most)
        if name in limits:
            most = min(most, limits[name]) if kind == FREE else limits[name]
            ends = (-most, most)
        elif model.jnt_limited[joint] and kind in (HINGE, SLIDE):
            ends = model.jnt_range[joint] - pose[model.jnt_qposadr[joint]]
        for amount in ends:
            change, moved = np.zeros(model.nv), pose.copy()
            change[dof] = amount
            mujoco.mj_integratePos(model, moved, change, 1.0)
            poses.append(moved)
    return np.stack(poses)


def auto_view(model: mujoco.MjModel, poses: np.ndarray, joints: Sequence[int], frame: tuple[int, int]) -> View:
    """The view in which the joint that shows least shows most, from as near as all poses allow.

    Args:
        model: compiled.
        poses: [P, nq], of which all have to be in the picture; the first is the one that is looked at.
        joints: degrees of freedom whose motion has to be seen.
        frame: height and width in pixels.
    """
    geoms = moving_geoms(model)
    data = mujoco.MjData(model)
    here = _corners(model, data, geoms, poses[0])
    motions = []
    for joint in joints:
        change, moved = np.zeros(model.nv), poses[0].copy()
        change[joint] = NUDGE
        mujoco.mj_integratePos(model, moved, change, 1.0)
        motions.append(_corners(model, data, geoms, moved) - here)
    cloud = np.concatenate([_corners(model, data, geoms, pose) for pose in poses])
    centre = (cloud.min(0) + cloud.max(0)) / 2

    def shown(direction: tuple[float, float]) -> float:
        right, up, _ = _axes(*direction)
        return min(_share(motion @ np.stack((right, up), axis=1), motion) for motion in motions)

    # rounded, so that of two that show about as much the plainer one is taken
    pitch, yaw = max(DIRECTIONS, key=lambda direction: round(shown(direction), 1))
    right, up, forward = _axes(pitch, yaw)
    half = math.tan(math.radians(FOVY / 2))
    reach = np.abs((cloud - centre) @ np.stack((right * frame[0] / frame[1], up), axis=1)).max(1)
    distance = MARGIN * float((reach / half - (cloud - centre) @ forward).max())
    return View(tuple((centre - distance * forward).tolist()), FOVY, yaw, pitch)


def _share(seen: np.ndarray, motion: np.ndarray) -> float:
    """How much of a motion [points, 3] is in its projection [points, 2]."""
    return float(np.linalg.norm(seen) / max(float(np.linalg.norm(motion)), 1e-12))


def _axes(pitch: float, yaw: float) -> np.ndarray:
    """Right, up and forward [3, 3] of a camera."""
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, View((0.0, 0.0, 0.0), FOVY, yaw, pitch).quaternion())
    right, up, back = axes.reshape(3, 3).T
    return np.stack((right, up, -back))


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int], pose: np.ndarray) -> np.ndarray:
    """Corners [geoms * 8, 3] of the boxes around the moving geoms."""
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    boxes = model.geom_aabb[geoms].reshape(-1, 2, 3)
    corners = boxes[:, :1] + CORNERS * boxes[:, 1:]
    axes = data.geom_xmat[geoms].reshape(-1, 3, 3)
    return (data.geom_xpos[geoms][:, None] + np.einsum("gij,gkj->gki", axes, corners)).reshape(-1, 3)
