"""Keeps the C library from handing a step's freed buffers back to the kernel, which would fault them in anew."""

from __future__ import annotations

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
LARGEST = 2**31 - 1


def keep_freed_memory() -> None:
    """Makes glibc reuse freed memory of any size; does nothing elsewhere.

    A training step on the CPU allocates and frees buffers of tens of megabytes. By default each is a mapping of its own
    whose pages the kernel clears again in every step: a tenth of the step's time, and a quarter of the augmentation's.
    """
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "gnu_get_libc_version"):
        libc.mallopt(M_MMAP_THRESHOLD, LARGEST)
        libc.mallopt(M_TRIM_THRESHOLD, LARGEST)
