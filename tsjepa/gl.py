"""Chooses the OpenGL backend that MuJoCo renders with; the only place in the package that does."""

from __future__ import annotations

import ctypes.util
import os
import sys

BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}


def choose_backend() -> str | None:
    """Set ``MUJOCO_GL`` to the first headless backend whose library is installed, unless the user has set it.

    Has to run before anything imports ``mujoco`` (``torchrl.envs`` does), because MuJoCo reads the variable once.

    Returns:
        The backend in force, or None on macOS (where MuJoCo picks its own) and where no backend is installed.
    """
    if "MUJOCO_GL" in os.environ or sys.platform == "darwin":
        return os.environ.get("MUJOCO_GL")
    for backend, library in BACKENDS.items():
        if ctypes.util.find_library(library):
            os.environ["MUJOCO_GL"] = backend
            return backend
    return None


def missing_backend_message() -> str:
    """The one sentence shown when frames are asked for and no GL backend is installed."""
    return (
        "No OpenGL backend for rendering was found: install EGL (Debian/Ubuntu: libegl1 libgl1-mesa-dri; conda-forge, "
        "without root: mesalib) or OSMesa (libosmesa6), or set MUJOCO_GL yourself; training from a data set that is "
        "already on disk needs none."
    )
