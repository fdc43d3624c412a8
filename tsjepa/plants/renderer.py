"""The fast renderer: pictures of a MuJoCo model from joint positions alone, through one persistent GL context."""

from __future__ import annotations

import atexit
import dataclasses
import os
import weakref

import mujoco
import numpy as np

from tsjepa.plants.appearance import MOST_DISTRACTORS, PLAIN, Surroundings
from tsjepa.plants.lens import Lens, View, rectangles
from tsjepa.support.gl import context_class, missing_backend_message

DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # of a geom that names no colour
BACKGROUNDS = 256  # that are kept: a fleet's episodes, each of which looks otherwise
DISABLED = ("SHADOW", "REFLECTION", "SKYBOX", "FOG", "HAZE")


def moving_geoms(model: mujoco.MjModel) -> list[int]:
    """The geoms that are fixed to a body which moves."""
    return [geom for geom in range(model.ngeom) if model.body_weldid[model.geom_bodyid[geom]] != 0]


def view_camera(model: mujoco.MjModel) -> int:
    """Index of the camera called "view", or of the first one."""
    return max(0, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, "view"))


def geom_colors(model: mujoco.MjModel, geoms: list[int]) -> np.ndarray:
    """RGB float32 [len(geoms), 3] as MuJoCo takes it: the material's, where the geom has one and names no colour."""
    colors = model.geom_rgba[geoms].copy()
    plain = (colors == DEFAULT_RGBA).all(axis=1) & (model.geom_matid[geoms] >= 0)
    colors[plain] = model.mat_rgba[model.geom_matid[geoms][plain]]
    return colors[:, :3].astype(np.float32)


def _release(gl: mujoco.GLContext, context: mujoco.MjrContext) -> None:
    gl.make_current()
    context.free()
    gl.free()


class Renderer:
    """Renders frames of a model; keeps its GL context, scene and buffers between calls.

    The context is made on the first frame, so an instance costs nothing (and needs no GL) until then. The background of
    every surroundings is rendered once; of every frame only the rectangle around what moves is, and put into it.

    Args:
        model: whose moving parts are geoms.
        view: the camera.
        height, width: of a frame in pixels.
    """

    def __init__(self, model: mujoco.MjModel, view: View, height: int, width: int) -> None:
        self.model, self.view, self.height, self.width = model, view, height, width
        self._gl = None

    def render(self, qpos: np.ndarray, colors: np.ndarray | None = None, around: Surroundings = PLAIN) -> np.ndarray:
        """Renders one frame per row.

        Args:
            qpos: [N, nq] joint positions, metres and radians.
            colors: [N, parts, 3] RGB in [0, 1] of the moving geoms, in the model's order; None for the model's own.
            around: light, camera and what stands behind and before the moving parts in all of these frames.

        Returns:
            uint8 [N, height, width, 3], a fresh array.

        Raises:
            ValueError: qpos or colors has the wrong shape or is not finite, or colors leave [0, 1].
            RuntimeError: no GL backend is installed.
        """
        qpos = np.asarray(qpos, np.float64)
        if qpos.ndim != 2 or qpos.shape[1] != self.model.nq:
            raise ValueError(f"qpos must have shape [N, {self.model.nq}], got {list(qpos.shape)}.")
        if not np.isfinite(qpos).all():
            raise ValueError(f"qpos must be finite, got {qpos[~np.isfinite(qpos).all(axis=1)][0]}.")
        if colors is not None:
            colors = np.asarray(colors, np.float32)
            parts = len(moving_geoms(self.model))
            if colors.shape != (len(qpos), parts, 3):
                raise ValueError(f"colors must have shape [{len(qpos)}, {parts}, 3], got {list(colors.shape)}.")
            if not ((colors >= 0) & (colors <= 1)).all():
                raise ValueError("colors must lie in [0, 1].")
        if not len(qpos):
            return np.empty((0, self.height, self.width, 3), np.uint8)
        self._ready()
        lens = self._surround(around)
        frames = np.repeat(self._background(around, lens)[None], len(qpos), axis=0)
        position, axes = self._poses(qpos)
        for row, rectangle in enumerate(rectangles(lens, position, axes, self._centres, self._extents)):
            left, bottom, width, height = rectangle.tolist()
            if width and height:
                for part, shape in enumerate(self._shapes):
                    shape.pos, shape.mat = position[row, part], axes[row, part]
                    shape.rgba[:3] = self._colors[part] if colors is None else colors[row, part]
                top = self.height - bottom - height
                frames[row, top : top + height, left : left + width] = self._draw(rectangle, lens)
        if around.occluder is not None:
            left, width, *color = around.occluder
            frames[:, :, left : left + width] = np.round(255 * np.array(color))
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
        return Renderer, (self.model, self.view, self.height, self.width)

    def _poses(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins [N, parts, 3] and axes [N, parts, 3, 3] of the moving parts."""
        parts = len(self._geoms)
        position, axes = np.empty((len(qpos), parts, 3)), np.empty((len(qpos), parts, 9))
        for row, coordinates in enumerate(qpos):
            self._data.qpos[:] = coordinates
            mujoco.mj_kinematics(self.model, self._data)
            position[row] = self._data.geom_xpos[self._geoms]
            axes[row] = self._data.geom_xmat[self._geoms]
        return position, axes.reshape(len(qpos), parts, 3, 3)

    def _draw(self, rectangle: np.ndarray, lens: Lens) -> np.ndarray:
        """The scene within a rectangle (left, bottom, width, height) of the frame; uint8 [height, width, 3]."""
        import cv2

        for camera in self._scene.camera:  # of both eyes, whose mean is used
            lens.aim(camera, rectangle)
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
        self.model.vis.global_.offheight, self.model.vis.global_.offwidth = height, width
        self.model.vis.quality.offsamples = self.view.samples
        self.model.vis.global_.fovy = self.view.fovy
        try:
            gl = context_class()(width, height)
            gl.make_current()
            # without any GL library it is only here that MuJoCo notices
            self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:
            raise RuntimeError(missing_backend_message()) from error
        self._data = mujoco.MjData(self.model)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._buffer = np.empty(height * width * 3, np.uint8)
        self._build_scene()
        self._gl = gl
        # At exit the context has to go before the display does; a plain finalizer would run after it.
        finalizer = weakref.finalize(self, _release, gl, self._context)
        finalizer.atexit = False
        atexit.register(finalizer)

    def _build_scene(self) -> None:
        self._scene = mujoco.MjvScene(self.model, maxgeom=self.model.ngeom + MOST_DISTRACTORS)
        for flag in DISABLED:
            self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 0
        camera = mujoco.MjvCamera()
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, view_camera(self.model)
        mujoco.mj_forward(self.model, self._data)
        option = mujoco.MjvOption()
        # of all that moves only geoms are drawn again in every frame
        option.sitegroup[:], option.tendongroup[:], option.skingroup[:] = 0, 0, 0
        mujoco.mjv_updateScene(
            self.model, self._data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        geom = mujoco.mjtObj.mjOBJ_GEOM
        shapes = {shape.objid: shape for shape in self._scene.geoms[: self._scene.ngeom] if shape.objtype == geom}
        # what the viewer's options hide, such as collision shapes, has no shape in the scene
        parts = [(part, geom) for part, geom in enumerate(moving_geoms(self.model)) if geom in shapes]
        self._geoms = [geom for _, geom in parts]
        self._shapes = [shapes[geom] for geom in self._geoms]
        self._colors = geom_colors(self.model, self._geoms)
        boxes = self.model.geom_aabb[self._geoms].reshape(-1, 2, 3)
        self._centres, self._extents = boxes[:, 0], boxes[:, 1]
        self._lens = Lens.of(self._scene.camera[0], self.height, self.width)
        self._lights = [
            (light, light.ambient.copy(), light.diffuse.copy())
            for light in self._scene.lights[: self._scene.nlight]
            if light.headlight
        ]
        self._own_geoms, self._around = self._scene.ngeom, PLAIN
        self._backgrounds: dict[Surroundings, np.ndarray] = {}
        centre = (self.model.stat.center - self._lens.position) @ self._lens.axes[2]
        self._depth = centre + self.model.stat.extent  # behind the whole model

    def _surround(self, around: Surroundings) -> Lens:
        """Puts the surroundings into the scene, where they stay; returns the lens that looks at them."""
        if around != self._around:
            for light, ambient, diffuse in self._lights:
                light.ambient, light.diffuse = around.light * ambient, around.light * diffuse
            for number, distractor in enumerate(around.distractors, self._own_geoms):
                right, up, wide, high, angle, red, green, blue = distractor
                size, position, axes = self._lens.box(right, up, wide, high, angle, self._depth)
                rgba = np.array((red, green, blue, 1.0), np.float32)
                mujoco.mjv_initGeom(self._scene.geoms[number], mujoco.mjtGeom.mjGEOM_BOX, size, position, axes, rgba)
            self._scene.ngeom = self._own_geoms + len(around.distractors)
            self._around = around
        return self._lens if around.shift == (0.0, 0.0) else dataclasses.replace(self._lens, shift=around.shift)

    def _background(self, around: Surroundings, lens: Lens) -> np.ndarray:
        """The picture [H, W, 3] without what moves."""
        if around not in self._backgrounds:
            if len(self._backgrounds) >= BACKGROUNDS:
                del self._backgrounds[next(iter(self._backgrounds))]
            for shape in self._shapes:
                shape.pos = lens.position - lens.axes[2] * 10  # behind the camera
            self._backgrounds[around] = self._draw(np.array((0, 0, self.width, self.height)), lens).copy()
        return self._backgrounds[around]
