"""Which part of the picture cart and pole cover, so that only that part is rendered."""

from __future__ import annotations

import dataclasses
import itertools

import mujoco
import numpy as np

MARGIN = 1  # pixels of the finished frame around the moving parts
CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


@dataclasses.dataclass(frozen=True)
class Lens:
    """Pose and frustum of a camera, in metres.

    Args:
        position: [3].
        axes: [3, 3], rows right, up, forward.
        near: distance of the near plane.
        half_height: half the height of the frustum on the near plane.
        height, width: of the frame in pixels.
    """

    position: np.ndarray
    axes: np.ndarray
    near: float
    half_height: float
    height: int
    width: int

    @classmethod
    def of(cls, camera: mujoco.MjvGLCamera, height: int, width: int) -> Lens:
        """The lens of a scene's camera that looks at whole frames of ``height`` x ``width`` pixels."""
        up, forward = np.array(camera.up, np.float64), np.array(camera.forward, np.float64)
        axes = np.stack((np.cross(forward, up), up, forward))
        return cls(np.array(camera.pos), axes, camera.frustum_near, camera.frustum_top, height, width)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixel coordinates [..., 2] (right of the left edge, above the bottom edge) of points [..., 3] in metres."""
        seen = (points - self.position) @ self.axes.T
        scale = self.near / self.half_height * self.height / 2
        return seen[..., :2] / seen[..., 2:] * scale + np.array((self.width, self.height)) / 2

    def aim(self, camera: mujoco.MjvGLCamera, rectangle: np.ndarray) -> None:
        """Narrows the frustum of ``camera`` to ``rectangle`` (left, bottom, width, height in pixels of the frame)."""
        left, bottom, width, height = rectangle.tolist()
        pixel = 2 * self.half_height / self.height
        camera.frustum_center = (left + width / 2 - self.width / 2) * pixel
        camera.frustum_bottom = (bottom - self.height / 2) * pixel
        camera.frustum_top = (bottom + height - self.height / 2) * pixel


def half_extents(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Half the edges [3] in metres of the box that holds a box or a capsule, in the geom's own axes."""
    size = model.geom_size[geom].copy()
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
        radius, half_length = size[:2]
        return np.array((radius, radius, half_length + radius))
    return size


def rectangles(lens: Lens, position: np.ndarray, axes: np.ndarray, extents: np.ndarray) -> np.ndarray:
    """The smallest rectangle of whole pixels, with a margin, around the moving parts of each frame.

    Args:
        lens: of the camera.
        position: [N, parts, 3] centres in metres.
        axes: [N, parts, 3, 3], the parts' own axes as columns.
        extents: [parts, 3] half edges in metres.

    Returns:
        int64 [N, 4]: left, bottom, width, height in pixels of the frame; width or height is 0 where nothing is visible.
    """
    corners = position[:, :, None] + np.einsum("npij,pkj->npki", axes, CORNERS * extents[:, None])
    pixels = lens.project(corners.reshape(len(corners), -1, 3))
    limit = np.array((lens.width, lens.height))
    low = np.clip(np.floor(pixels.min(1)) - MARGIN, 0, limit)
    high = np.clip(np.ceil(pixels.max(1)) + MARGIN, 0, limit)
    return np.concatenate((low, high - low), axis=1).astype(np.int64)
