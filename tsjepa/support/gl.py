"""Chooses the OpenGL backend that MuJoCo renders with; the only place in the package that does.

Run as a script (``python gl.py``) it tells by its exit status whether EGL can be initialised.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib
import os
import subprocess
import sys
from pathlib import Path

_EGL_PLATFORM_DEVICE = 0x313F


def choose_backend() -> str | None:
    """Set ``MUJOCO_GL`` to EGL where it works, else OSMesa, unless the user has set it (an empty value is none).

    Has to run before anything imports ``mujoco`` (``torchrl.envs`` does), because MuJoCo reads the variable once.
    EGL is tried out, in a child process, only where OSMesa is there to fall back on.

    Returns:
        The backend in force, or None where nothing is set: on macOS and Windows, where MuJoCo picks its own, and on a
        machine without either library.
    """
    if os.environ.get("MUJOCO_GL") or sys.platform != "linux":
        return os.environ.get("MUJOCO_GL")
    # PyOpenGL needs the library of the GL functions beside EGL's.
    has_egl = _is_installed("EGL") and (_is_installed("GL") or _is_installed("OpenGL"))
    has_osmesa = _is_installed("OSMesa")
    if has_egl and (not has_osmesa or _egl_works()):
        os.environ["MUJOCO_GL"] = "egl"
    elif has_osmesa:
        os.environ["MUJOCO_GL"] = "osmesa"
    return os.environ.get("MUJOCO_GL")


def context_class() -> type:
    """MuJoCo's GL context for the backend in force.

    ``mujoco.GLContext`` is chosen when mujoco is imported, and a program may do that before it imports this package.
    """
    backend = os.environ.get("MUJOCO_GL", "")
    module = f"mujoco.{backend}" if backend in ("egl", "osmesa") else "mujoco"
    return importlib.import_module(module).GLContext


def missing_backend_message() -> str:
    """The one sentence shown when frames are asked for and no GL backend is installed."""
    return (
        "No OpenGL backend that can render was found: install EGL (Debian/Ubuntu: libegl1 libopengl0 libgl1-mesa-dri; "
        "conda-forge, without root: mesalib) or OSMesa (libosmesa6), or set MUJOCO_GL yourself; training from a data "
        "set that is already on disk needs none."
    )


def _is_installed(library: str) -> bool:
    """Whether the loader would find ``lib<library>.so``; never loads it (Mesa's LLVM clashes with Triton's)."""
    folders = [*os.environ.get("LD_LIBRARY_PATH", "").split(":"), f"{sys.base_prefix}/lib"]
    beside_the_system = any(folder and any(Path(folder).glob(f"lib{library}.so*")) for folder in folders)
    return beside_the_system or ctypes.util.find_library(library) is not None


def _egl_works() -> bool:
    try:
        trial = subprocess.run([sys.executable, "-I", __file__], capture_output=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return trial.returncode == 0


def _initialise_egl() -> bool:
    """Initialise a display on any EGL device, as MuJoCo does."""
    for name in ("libEGL.so", "libEGL.so.1"):
        try:
            egl = ctypes.CDLL(name)
            break
        except OSError:
            continue
    else:
        return False
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    query, display_of = (egl.eglGetProcAddress(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT"))
    if not query or not display_of:
        return False
    devices, count = (ctypes.c_void_p * 16)(), ctypes.c_int()
    ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(query)(
        16, devices, ctypes.byref(count)
    )
    display_of = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)(display_of)
    egl.eglInitialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    displays = (display_of(_EGL_PLATFORM_DEVICE, device, None) for device in devices[: count.value])
    return any(display and egl.eglInitialize(display, None, None) for display in displays)


if __name__ == "__main__":
    sys.exit(0 if _initialise_egl() else 1)
