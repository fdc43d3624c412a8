"""``tsjepa doctor``: what this machine offers, whether it can render and train, and what to mend."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from tsjepa.support.gl import missing_backend_message
from tsjepa.support.processor import cores, processor

# Frames of the data sets, checkpoints and logs of `make train-jepa`.
_NEEDED_DISK_GIB = 4
ALL_WELL = "All is well: this machine can collect data and train."
_TRIAL = """
import time
import numpy as np
from tsjepa.plants import CartPole

plant, rows = CartPole(), np.arange({frames} + 20)
scenes = plant.scene(plant.start(0, rows, 0 * rows), 0, rows, 0 * rows)
first = plant.render(scenes[:20])
start = time.perf_counter()
plant.render(scenes[20:])
print("frames/s", {frames} / (time.perf_counter() - start) if first.std() > 0 else 0.0)
"""


def doctor(frames: int = 200) -> dict[str, Any]:
    """Print what was found, one line each, and what to mend, one sentence each.

    Args:
        frames: Number of frames to render when the speed of the camera is measured.

    Returns:
        ``found``, by name, and the sentences of ``mend``, without which data can be collected and a model trained.

    Raises:
        ValueError: If ``frames`` is below 1.
    """
    if frames < 1:
        raise ValueError(f"frames is {frames}; at least 1 has to be rendered to measure the speed.")
    to_mend, found, busy = [], {}, _busy()
    for check in (_machine, _packages, _devices, lambda: _rendering(frames), _commands, _disk):
        lines, problems = check()
        print(*(f"{name:<12}{value}" for name, value in lines), sep="\n", flush=True)
        to_mend += problems
        found |= dict(lines)
    if not to_mend:
        if busy:
            print(f"{'note':<12}{busy}", flush=True)
        rate = float(found["rendering"].split(": ")[1].split()[0])
        speed = _speed(rate)
        print(*(f"{name:<12}{value}" for name, value in speed), sep="\n", flush=True)
        found |= dict(speed)
    print()
    print(*[f"mend: {sentence}" for sentence in to_mend] or [ALL_WELL], sep="\n")
    return {"found": found, "mend": to_mend}


Report = tuple[list[tuple[str, str]], list[str]]


def _machine() -> Report:
    lines = [
        ("python", f"{platform.python_version()} ({sys.executable})"),
        ("system", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("cpu", f"{processor()}, {cores()} usable cores"),
    ]
    return lines, []


def _packages() -> Report:
    """Compare what is installed with the pins of this package's own metadata."""
    try:
        requirements = [Requirement(line) for line in importlib.metadata.requires("tsjepa") or []]
    except importlib.metadata.PackageNotFoundError:
        return [("tsjepa", "not installed")], [
            "tsjepa itself is not installed: run `make setup`, or `pip install -e .`."
        ]
    lines, problems = [], []
    for requirement in requirements:
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            version = "none"
        if version == "none" or not requirement.specifier.contains(version, prereleases=True):
            problems.append(
                f"{requirement.name} is {version} but has to be {requirement.specifier}: run `make setup`, or "
                f"`pip install '{requirement.name}{requirement.specifier}'`."
            )
        lines.append((requirement.name, version))
    shown = ", ".join(f"{name} {version}" for name, version in lines)
    return [("packages", shown)], problems


def _devices() -> Report:
    try:
        import torch
    except (ImportError, OSError) as error:
        return [("device", "none")], [f"torch cannot be imported ({error}): run `make setup`."]
    if torch.cuda.is_available():
        gpu = torch.cuda.get_device_properties(0)
        return [("device", f"cuda: {gpu.name}, {gpu.total_memory / 2**30:.0f} GiB")], []
    lines = [("device", f"cpu, {torch.get_num_threads()} threads")]
    if shutil.which("nvidia-smi") and torch.version.cuda is None:
        lines.append(("note", "this machine has an NVIDIA driver, but the torch installed here is a CPU build"))
    return lines, []


def _busy() -> str | None:
    """What other programs take of this machine, where that makes the figures smaller than they would be."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    if load < 0.5:
        return None
    return f"other programs keep about {load:.1f} cores busy: all that follows is faster without them"


def _speed(frames_per_second: float) -> list[tuple[str, str]]:
    """What fits compute in here, how fast products are, and about how long the main job takes."""
    import torch

    from tsjepa.cli.estimate import gemm_rate, main_job
    from tsjepa.support.precision import describe

    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    rates = {name: gemm_rate(getattr(torch, name), device) for name in ("float32", "bfloat16")}
    chosen, seconds = main_job(device, frames_per_second)
    return [
        ("products", ", ".join(f"{rate / 1e9:,.3g} GFLOP/s in {name}" for name, rate in rates.items())),
        ("precision", describe(chosen, device)),
        ("estimate", f"make train-jepa takes about {max(1, round(seconds / 60))} min"),
    ]


def _rendering(frames: int) -> Report:
    """Render in a child process, so that a driver that crashes is reported like any other fault."""
    backend = os.environ.get("MUJOCO_GL") or ("the system's own" if sys.platform != "linux" else "none")
    try:
        trial = subprocess.run(
            [sys.executable, "-c", _TRIAL.format(frames=frames)], capture_output=True, text=True, timeout=300
        )
        output, fault = trial.stdout, (trial.stderr.strip().splitlines() or [f"exit status {trial.returncode}"])[-1]
    except subprocess.TimeoutExpired:
        output, fault = "", "the camera took more than five minutes"
    speed = re.search(r"^frames/s (\S+)$", output, re.MULTILINE)
    if speed is None:
        without = backend == "none" or missing_backend_message() in fault
        sentence = missing_backend_message() if without else f"Rendering failed: {fault}"
        return [("rendering", f"{backend}: does not render")], [sentence]
    if float(speed.group(1)) == 0:
        return [("rendering", f"{backend}: empty frames")], [f"MUJOCO_GL={backend} renders empty frames: set another."]
    return [("rendering", f"{backend}: {float(speed.group(1)):.0f} frames/s")], []


def _commands() -> Report:
    """`lightning-sdk` installs a command of the same name over ours."""
    script = Path(sys.executable).parent / "lightning"
    if script.exists() and "tsjepa.cli" in script.read_text(errors="replace"):
        return [("commands", "tsjepa, lightning")], []
    return [
        ("commands", "tsjepa"),
        ("note", "`lightning` is not ours here: `make setup` brings ours back"),
    ], []


def _disk() -> Report:
    free = shutil.disk_usage(Path.cwd()).free / 2**30
    line = [("disk", f"{free:.0f} GiB free here")]
    if free < _NEEDED_DISK_GIB:
        return line, [f"Only {free:.1f} GiB are free here: make room for {_NEEDED_DISK_GIB} GiB of frames."]
    return line, []
