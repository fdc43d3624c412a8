"""How fast this machine multiplies, and about how long ``make train-jepa`` takes on it, for the doctor."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path

import torch
import yaml
from tensordict import TensorDict
from torch import nn
from torch.nn import functional as F

from tsjepa.data.module import Trajectories
from tsjepa.support.description import build
from tsjepa.support.precision import BFLOAT16, MEMORY_FORMATS, Precision, choose
from tsjepa.support.recipes import find_recipe
from tsjepa.training.finish.refine import RefinePredictor, refine_predictor
from tsjepa.training.jepa import TSJEPA

LONG_ENOUGH_S = 0.02  # of one product; a shorter one says nothing, and the next is at most eight times as long
RECIPE, DATA_RECIPE = "recipes/jepa.yaml", "recipes/data.yaml"
WINDOWS = 8  # of a trial step, whose time is taken to grow with their number
TRIALS = 3
AND_THE_REST = 1.25  # actor and evaluation take about a quarter of data, training and finish


def gemm_rate(dtype: torch.dtype, device: torch.device) -> float:
    """FLOP/s of a product of square matrices, as large as this machine multiplies in well under a second."""
    side = 64
    while True:
        side *= 2
        matrix = torch.ones(side, side, dtype=dtype, device=device)
        seconds = _seconds(lambda matrix=matrix: matrix @ matrix, device)
        if seconds >= LONG_ENOUGH_S or side == 16384:
            return 2 * side**3 / seconds


def main_job(device: torch.device, frames_per_second: float) -> tuple[Precision, float]:
    """What the main job computes in here, and about how many seconds it takes.

    Args:
        device: of the training.
        frames_per_second: of the camera, with which the data set is collected.
    """
    recipe, data = (yaml.safe_load(Path(find_recipe(name)).read_text()) for name in (RECIPE, DATA_RECIPE))
    parts = recipe["model"]["init_args"]
    names = ("encoder", "predictor", "augmentation")
    module = Untrained(**{name: build(parts[name], lambda kind: issubclass(kind, nn.Module)) for name in names})
    windows = Trajectories(**recipe["data"]["init_args"])
    frames = {name: split["episodes"] * (data["slots"] + 1) for name, split in data["splits"].items()}
    episodes = sum(data["splits"][name]["episodes"] for name in windows.splits)
    steps = recipe["trainer"]["max_epochs"] * len(windows.sampler(episodes, data["slots"] + 1))
    chosen = choose(module.encoder, device)
    seconds = sum(frames.values()) / frames_per_second
    trials = steps * windows.frames_per_batch / (WINDOWS * windows.stacks)
    seconds += trials * step_seconds(module, windows, chosen, device)
    for callback in recipe["trainer"]["callbacks"]:
        if callback["class_path"].endswith("RefinePredictor"):
            refine = RefinePredictor(**callback.get("init_args", {}))
            seconds += refine.steps * refine_seconds(module, refine, chosen, device)
    return chosen, AND_THE_REST * seconds


class Untrained(TSJEPA):
    """The main job's module, attached to no trainer."""

    global_step = 0

    def log_terms(self, *terms) -> None:
        pass


def step_seconds(module: TSJEPA, windows: Trajectories, chosen: Precision, device: torch.device) -> float:
    """Seconds of a training step with :data:`WINDOWS` windows."""
    module.to(device, memory_format=MEMORY_FORMATS[chosen.memory_format]).train()
    stack, height, width, colors = module.encoder.frame_shape
    shape = (WINDOWS, windows.stacks, height // 4, width // 4, 16 * colors * stack)
    patches = torch.randint(0, 256, shape, dtype=torch.uint8).to(device)
    commands = torch.zeros(WINDOWS, windows.stacks - 1, module.predictor.action_dim, device=device)
    optimizer = torch.optim.AdamW(parameter for parameter in module.parameters() if parameter.requires_grad)

    def step() -> None:
        with _autocast(chosen, device):
            loss = module.training_step({"patches": patches, "commands": commands}, 0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        module.on_train_batch_end(None, None, 0)

    return _seconds(step, device)


def refine_seconds(module: TSJEPA, refine: RefinePredictor, chosen: Precision, device: torch.device) -> float:
    """Seconds of a step of the predictor's finish."""
    slots = refine.horizon + 1
    embedding = F.normalize(torch.randn(8, slots + 1, module.encoder.embedding_dim, device=device), dim=-1)
    action = torch.zeros(8, slots + 1, module.predictor.action_dim, device=device)
    embedded = TensorDict({"embedding": embedding, "action": action}, batch_size=[8, slots + 1])
    options = {"horizon": refine.horizon, "batch_size": refine.batch_size, "learning_rate": 1e-3, "seed": 0}
    context = {"forward_context": lambda: _autocast(chosen, device)}
    with redirect_stderr(StringIO()):  # its progress bars
        return _seconds(lambda: refine_predictor(module.predictor, embedded, 2, **options, **context), device) / 2


def _autocast(chosen: Precision, device: torch.device) -> torch.autocast:
    return torch.autocast(device.type, torch.bfloat16, enabled=chosen.trainer == BFLOAT16)


def _seconds(step: Callable[[], object], device: torch.device) -> float:
    """The least of a few turns after a first one."""
    times = []
    for _ in range(1 + TRIALS):
        start = time.perf_counter()
        step()
        if device.type != "cpu":
            torch.accelerator.synchronize(device)
        times.append(time.perf_counter() - start)
    return min(times[1:])
