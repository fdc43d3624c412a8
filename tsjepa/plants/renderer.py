"""The camera: renders cart-poles from qpos alone, fast, through one persistent GL context."""

from __future__ import annotations

import atexit
import dataclasses
import math
import os
import weakref

import mujoco
import numpy as np

from tsjepa.plants.crop import Lens, half_extents, rectangles
from tsjepa.plants.dynamics import load_model
from tsjepa.support.gl import missing_backend_message

HEIGHT, WIDTH = 64, 128
MOVING = ("cart", "pole")
DEFAULT_COLORS = ((0.7, 0.5, 0.3), (0.7, 0.5, 0.3))
DISABLED = ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE")


@dataclasses.dataclass(frozen=True)
class View:
    """Where the camera is and how it samples: position (m), vertical field of view and clockwise-seen roll (degrees),
    multi-samples, and the factor by which a larger picture is rendered and averaged down."""

    fovy: float
    position: tuple[float, float, float]
    roll: float
    samples: int
    supersampling: int


# A rolled camera meets every edge at many sub-pixel phases, and four samples on a doubled grid make sixteen a pixel:
# two frames 40 ms apart then give velocity to 5 mm/s, against 35 for an upright view with four samples, 49 with none.
# The width just holds the cart and the leaning pole at |x| <= 1.3 m, |theta| <= 0.35 rad.
VIEW = View(fovy=24.4, position=(0.04, -4.0, 1.45), roll=5.0, samples=4, supersampling=2)


def apply_view(model: mujoco.MjModel, view: View, height: int, width: int) -> None:
    """Point the model's only camera, and size its off-screen buffer, for `view`."""
    level, turn, pose = np.zeros(4), np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(level, np.array([1.0, 0.0, 0.0]), math.pi / 2)
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), math.radians(view.roll))
    mujoco.mju_mulQuat(pose, level, turn)
    model.cam_pos[0], model.cam_quat[0], model.cam_fovy[0] = view.position, pose, view.fovy
    model.vis.global_.offheight, model.vis.global_.offwidth = height, width
    model.vis.quality.offsamples = view.samples


def _release(gl: mujoco.GLContext, context: mujoco.MjrContext) -> None:
    gl.make_current()
    context.free()
    gl.free()


class Renderer:
    """Renders frames of cart-poles; keeps its GL context, scene and buffers between calls.

    The context is made on the first frame, so an instance costs nothing (and needs no GL) until then. The background is
    rendered once; of every frame only the rectangle around cart and pole is, and put into it.

    Args:
        height: frame height in pixels.
        width: frame width in pixels.
        view: the camera.
    """

    def __init__(self, height: int = HEIGHT, width: int = WIDTH, view: View = VIEW) -> None:
        self.height, self.width, self.view = height, width, view
        self._gl = None

    def render(self, qpos: np.ndarray, colors: np.ndarray | None = None) -> np.ndarray:
        """Render one frame per row.

        Args:
            qpos: [N, 2] cart position (m) and pole angle (rad, 0 upright).
            colors: [N, 2, 3] RGB in [0, 1] of cart and pole, or None for the default colours.

        Returns:
            uint8 [N, height, width, 3], a fresh array.

        Raises:
            ValueError: if qpos or colors has the wrong shape or is not finite, or colors leave [0, 1].
            RuntimeError: if no GL backend is installed.
        """
        qpos = np.asarray(qpos, np.float64)
        if qpos.ndim != 2 or qpos.shape[1] != 2:
            raise ValueError(f"qpos must have shape [N, 2] (x, theta), got {list(qpos.shape)}.")
        if not np.isfinite(qpos).all():
            raise ValueError(f"qpos must be finite, got {qpos[~np.isfinite(qpos).all(axis=1)][0]}.")
        if colors is not None:
            colors = np.asarray(colors, np.float32)
            if colors.shape != (len(qpos), 2, 3):
                raise ValueError(f"colors must have shape [{len(qpos)}, 2, 3], got {list(colors.shape)}.")
            if not ((colors >= 0) & (colors <= 1)).all():
                raise ValueError("colors must lie in [0, 1].")
        if not len(qpos):
            return np.empty((0, self.height, self.width, 3), np.uint8)
        self._ready()
        frames = np.repeat(self._background[None], len(qpos), axis=0)
        position, axes = self._poses(qpos)
        for row, rectangle in enumerate(rectangles(self._lens, position, axes, self._extents)):
            left, bottom, width, height = rectangle.tolist()
            if width and height:
                for part, shape in enumerate(self._shapes):
                    shape.pos, shape.mat = position[row, part], axes[row, part]
                    shape.rgba[:3] = DEFAULT_COLORS[part] if colors is None else colors[row, part]
                top = self.height - bottom - height
                frames[row, top : top + height, left : left + width] = self._draw(rectangle)
        return frames

    def metadata(self) -> dict:
        """What a data set has to record to say how its frames were made; creates the GL context."""
        self._ready()
        from OpenGL import GL

        return {
            "height": self.height,
            "width": self.width,
            "view": dataclasses.asdict(self.view),
            "samples": int(self._context.offSamples),
            "disabled_flags": list(DISABLED),
            "backend": os.environ.get("MUJOCO_GL", "default"),
            "gl_renderer": GL.glGetString(GL.GL_RENDERER).decode(),
            "mujoco": mujoco.__version__,
        }

    def __reduce__(self):
        """A copy, or an instance sent to another process, makes its own context."""
        return Renderer, (self.height, self.width, self.view)

    def _poses(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres [N, parts, 3] and axes [N, parts, 3, 3] of the moving parts."""
        position = np.empty((len(qpos), len(MOVING), 3))
        axes = np.empty((len(qpos), len(MOVING), 9))
        for row, coordinates in enumerate(qpos):
            self._data.qpos[:] = coordinates
            mujoco.mj_kinematics(self._model, self._data)
            position[row] = self._data.geom_xpos[self._geoms]
            axes[row] = self._data.geom_xmat[self._geoms]
        return position, axes.reshape(len(qpos), len(MOVING), 3, 3)

    def _draw(self, rectangle: np.ndarray) -> np.ndarray:
        """The scene within a rectangle (left, bottom, width, height) of the frame; uint8 [height, width, 3]."""
        import cv2

        for camera in self._scene.camera:  # of both eyes, whose mean is used
            self._lens.aim(camera, rectangle)
        _, _, width, height = rectangle.tolist()
        scale = self.view.supersampling
        viewport = mujoco.MjrRect(0, 0, scale * width, scale * height)
        buffer = self._buffer[: 3 * viewport.width * viewport.height].reshape(viewport.height, viewport.width, 3)
        mujoco.mjr_render(viewport, self._scene, self._context)
        mujoco.mjr_readPixels(buffer, None, viewport, self._context)
        picture = buffer if scale == 1 else cv2.resize(buffer, (width, height), interpolation=cv2.INTER_AREA)
        # OpenGL's first row is the bottom one.
        return picture[::-1]

    def _ready(self) -> None:
        if self._gl is not None:
            try:
                # Another renderer of this process may have made its own context current.
                self._gl.make_current()
                return
            except Exception:
                # The driver has dropped the context (a GPU that was reset, a laptop that slept): make a new one.
                self._gl = None
        scale = self.view.supersampling
        height, width = self.height * scale, self.width * scale
        self._model = load_model()
        apply_view(self._model, self.view, height, width)
        try:
            gl = mujoco.GLContext(width, height)
            gl.make_current()
            # without any GL library it is only here that MuJoCo notices
            self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:
            raise RuntimeError(missing_backend_message()) from error
        self._data = mujoco.MjData(self._model)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._buffer = np.empty(height * width * 3, np.uint8)
        self._build_scene()
        self._background = self._draw(np.array((0, 0, self.width, self.height))).copy()
        self._gl = gl
        # At exit the context has to go before the display does; a plain finalizer would run after it.
        finalizer = weakref.finalize(self, _release, gl, self._context)
        finalizer.atexit = False
        atexit.register(finalizer)

    def _build_scene(self) -> None:
        self._scene = mujoco.MjvScene(self._model, maxgeom=16)
        for flag in DISABLED:
            self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
        camera = mujoco.MjvCamera()
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        mujoco.mj_forward(self._model, self._data)
        option = mujoco.MjvOption()
        mujoco.mjv_updateScene(
            self._model, self._data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        shapes = {shape.objid: shape for shape in self._scene.geoms[: self._scene.ngeom]}
        self._geoms = [self._model.geom(name).id for name in MOVING]
        self._shapes = [shapes[geom] for geom in self._geoms]
        self._extents = np.stack([half_extents(self._model, geom) for geom in self._geoms])
        self._lens = Lens.of(self._scene.camera[0], self.height, self.width)
        for shape in self._shapes:  # behind the camera, until the background is drawn
            shape.pos = self._lens.position - self._lens.axes[2] * 10
