"""Where a camera stands, and which part of its picture the moving parts cover, so that only that part is rendered."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco

MARGIN = 1  # pixels of the finished frame around the moving parts
THICKNESS = 1e-3  # of a flat box, over the frame's height
CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


@dataclasses.dataclass(frozen=True)
class View:
    """A camera and how it samples.

    Args:
        position: in metres.
        fovy: vertical field of view, degrees.
        yaw: degrees to the left of looking along +y.
        pitch: degrees down from the horizontal; 90 looks straight down.
        roll: degrees that the picture is turned, seen clockwise.
        samples: multi-samples of a pixel.
        supersampling: factor by which a larger picture is rendered and averaged down.
        eyes: metres between the two eyes whose mean MuJoCo draws. Only with 0 is what is drawn of a picture exactly
            where the moving parts are.
        orientation: as a quaternion, scalar first, instead of yaw, pitch and roll.
    """

    position: tuple[float, float, float]
    fovy: float
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    samples: int = 4
    supersampling: int = 2
    eyes: float = 0.0
    orientation: tuple[float, float, float, float] | None = None

    def quaternion(self) -> np.ndarray:
        """The camera's orientation [4], scalar first."""
        if self.orientation is not None:
            return np.array(self.orientation)
        pose = _turn((1.0, 0.0, 0.0), math.pi / 2 - math.radians(self.pitch))
        if self.yaw:
            pose = _multiply(_turn((0.0, 0.0, 1.0), math.radians(self.yaw)), pose)
        return _multiply(pose, _turn((0.0, 0.0, 1.0), math.radians(self.roll)))


def _turn(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    return np.concatenate([[math.cos(angle / 2)], math.sin(angle / 2) * np.array(axis)])


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )


@dataclasses.dataclass(frozen=True)
class Lens:
    """Pose and frustum of a camera, in metres.

    Args:
        position: [3].
        axes: [3, 3], rows right, up, forward.
        near: distance of the near plane.
        half_height: half the height of the frustum on the near plane.
        height, width: of the frame in pixels.
        shift: pixels by which the picture is moved right and up.
    """

    position: np.ndarray
    axes: np.ndarray
    near: float
    half_height: float
    height: int
    width: int
    shift: tuple[float, float] = (0.0, 0.0)

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
        return seen[..., :2] / seen[..., 2:] * scale + np.array((self.width, self.height)) / 2 + self.shift

    def box(self, right: float, up: float, wide: float, high: float, angle: float, depth: float) -> tuple:
        """A flat box that faces the camera, as MuJoCo's half edges [3], position [3] and axes [9].

        Args:
            right, up: of its centre from the middle of the unmoved picture, over the frame's height.
            wide, high: its edges over the frame's height.
            angle: radians by which it is turned, seen anticlockwise.
            depth: metres before the camera.
        """
        tall = 2 * self.half_height / self.near * depth  # of what the frame shows there, metres
        x, y, forward = self.axes
        turned = math.cos(angle) * x + math.sin(angle) * y, math.cos(angle) * y - math.sin(angle) * x, -forward
        position = self.position + depth * forward + tall * (right * x + up * y)
        return np.array((wide, high, THICKNESS)) * tall / 2, position, np.stack(turned, axis=1).reshape(9)

    def aim(self, camera: mujoco.MjvGLCamera, rectangle: np.ndarray) -> None:
        """Narrows the frustum of ``camera`` to ``rectangle`` (left, bottom, width, height in pixels of the frame)."""
        left, bottom, width, height = rectangle.tolist()
        left, bottom = left - self.shift[0], bottom - self.shift[1]
        pixel = 2 * self.half_height / self.height
        camera.frustum_center = (left + width / 2 - self.width / 2) * pixel
        camera.frustum_bottom = (bottom - self.height / 2) * pixel
        camera.frustum_top = (bottom + height - self.height / 2) * pixel


def rectangles(
    lens: Lens, position: np.ndarray, axes: np.ndarray, centres: np.ndarray, extents: np.ndarray
) -> np.ndarray:
    """The smallest rectangle of whole pixels, with a margin, around the moving parts of each frame.

    Args:
        lens: of the camera.
        position: [N, parts, 3] origins in metres.
        axes: [N, parts, 3, 3], the parts' own axes as columns.
        centres, extents: [parts, 3] centre and half edges, in metres and own axes, of the box that holds each part.

    Returns:
        int64 [N, 4]: left, bottom, width, height in pixels of the frame; width or height is 0 where nothing is visible.
    """
    corners = centres[:, None] + CORNERS * extents[:, None]
    corners = position[:, :, None] + np.einsum("npij,pkj->npki", axes, corners)
    corners = corners.reshape(len(corners), -1, 3)
    pixels, limit = lens.project(corners), np.array((lens.width, lens.height))
    low = np.clip(np.floor(pixels.min(1)) - MARGIN, 0, limit)
    high = np.clip(np.ceil(pixels.max(1)) + MARGIN, 0, limit)
    # what reaches behind the near plane has no bounds in the picture
    behind = ((corners - lens.position) @ lens.axes[2] < lens.near).any(1)
    low[behind], high[behind] = 0, limit
    return np.concatenate((low, high - low), axis=1).astype(np.int64)
