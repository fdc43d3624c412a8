"""Shared by all tests: the GL backend is chosen before a test imports mujoco, and no test depends on time or luck."""

import os

from hypothesis import settings

import tsjepa  # noqa: F401

os.environ.setdefault("WANDB_MODE", "offline")
# Set before torch is imported: threads that wait for each other make the small tensors of tests slow on a busy machine.
os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("reproducible", deadline=None, derandomize=True)
settings.load_profile("reproducible")
