"""The choice of the GL backend, on machines that this one is not."""

import os
import subprocess
import sys

import pytest

from tsjepa.support import gl

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere MuJoCo chooses its own backend")


@linux_only
@pytest.mark.parametrize(
    ("installed", "egl_works", "expected"),
    [
        ({"EGL", "GL"}, False, "egl"),
        ({"EGL", "OpenGL"}, False, "egl"),
        ({"OSMesa"}, False, "osmesa"),
        ({"EGL", "GL", "OSMesa"}, True, "egl"),
        ({"EGL", "GL", "OSMesa"}, False, "osmesa"),
        ({"EGL", "OSMesa"}, True, "osmesa"),
        ({"EGL"}, True, None),
        (set(), False, None),
    ],
)
def test_backend_follows_what_is_installed_and_works(monkeypatch, installed, egl_works, expected):
    monkeypatch.setattr(os, "environ", {})
    monkeypatch.setattr(gl, "_is_installed", installed.__contains__)
    monkeypatch.setattr(gl, "_egl_works", lambda: egl_works)
    assert gl.choose_backend() == expected
    assert os.environ.get("MUJOCO_GL") == expected


def test_choice_of_the_user_stands(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    assert gl.choose_backend() == "glfw"


@linux_only
def test_an_empty_choice_is_none(monkeypatch):
    monkeypatch.setattr(os, "environ", {"MUJOCO_GL": ""})
    monkeypatch.setattr(gl, "_is_installed", {"OSMesa"}.__contains__)
    assert gl.choose_backend() == "osmesa"


def test_importing_the_package_sets_the_backend_and_imports_nothing_heavy():
    code = "import sys, tsjepa; print(*(name for name in ('torch', 'mujoco', 'lightning') if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@linux_only
def test_egl_without_a_vendor_is_found_not_to_work(monkeypatch):
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_DIRS", "/nonexistent")
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent")
    assert not gl._egl_works()


@pytest.mark.slow
def test_a_program_that_imports_mujoco_first_draws_too():
    program = """
import mujoco, numpy as np
from tsjepa.plants import CartPole
plant, row = CartPole(), np.zeros(1, np.int64)
print(plant.render(plant.scene(plant.start(0, row, row), 0, row, row)).max())
"""
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100
