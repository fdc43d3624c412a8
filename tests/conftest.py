"""Shared by all tests: the GL backend is chosen before a test imports mujoco, and no test depends on time or luck."""

import os

from hypothesis import settings

import tsjepa  # noqa: F401

os.environ.setdefault("WANDB_MODE", "offline")
settings.register_profile("reproducible", deadline=None, derandomize=True)
settings.load_profile("reproducible")
