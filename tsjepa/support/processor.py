"""The processor of this machine: its name, its instruction sets, and the cores that this process may use."""

from __future__ import annotations

import math
import os
import platform
import subprocess
import sys
from pathlib import Path

CPUINFO, QUOTA = Path("/proc/cpuinfo"), Path("/sys/fs/cgroup/cpu.max")  # of Linux, and of its containers


def processor() -> str:
    """Name of the processor."""
    if sys.platform == "darwin":
        words = ["sysctl", "-n", "machdep.cpu.brand_string"]
        return subprocess.run(words, capture_output=True, text=True).stdout.strip()
    try:
        lines = CPUINFO.read_text().splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def cores() -> int:
    """Cores that this process may use: not those that its affinity excludes, nor more than its container's quota."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = QUOTA.read_text().split()
    except OSError:
        return count
    return count if quota == "max" else min(count, math.ceil(int(quota) / int(period)))


def cpu_flags() -> list[str]:
    """The processor's instruction sets that decide the speed, such as avx2, avx512_f, avx512_bf16, amx_bf16."""
    import torch  # which `tsjepa doctor` may find broken

    known = ("avx2", "avx512_f", "avx512_bf16", "avx512_fp16", "amx_bf16", "amx_fp16")
    found = torch.cpu.get_capabilities()
    return [
        name for name, value in found.items() if value is True and (name in known or name.startswith(("arm", "sve")))
    ]
