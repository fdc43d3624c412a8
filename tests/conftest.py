"""Shared by all tests: the GL backend is chosen before a test imports mujoco, and no test depends on time or luck."""

import os
from collections import Counter

from hypothesis import settings

import tsjepa  # noqa: F401

os.environ.setdefault("WANDB_MODE", "offline")
# Set before torch is imported: threads that wait for each other make the small tensors of tests slow on a busy machine.
os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("reproducible", deadline=None, derandomize=True)
settings.load_profile("reproducible")


def pytest_collection_modifyitems(items) -> None:
    """Files with many slow tests first: a file stays in one process, and the last one leaves the others idle."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])
