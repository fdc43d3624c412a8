"""Which number format and memory format this machine computes fastest in; the one place that decides.

bfloat16 is twice as fast as float32 where the processor multiplies in it, and several times slower where it is
emulated. Which memory format wins differs from processor to processor, so it is measured on the encoder in use.
"""

from __future__ import annotations

import copy
import os
import platform
import time
from dataclasses import dataclass

import torch
from torch import nn

from tsjepa.support.processor import cpu_flags, processor

FLOAT32, BFLOAT16 = "32-true", "bf16-mixed"  # as Lightning's trainer.precision names them
MEMORY_FORMATS = {"channels_last": torch.channels_last, "contiguous": torch.contiguous_format}
BUDGET_S = 0.7  # for all measured steps but the first ones
LEAST_TURNS, MOST_TURNS = 3, 10  # whatever they take, one alone may have been interrupted
STACKS = 32  # a step of the measurement; fewer where the encoder is slow
ALIKE = 0.9  # a choice that takes at most 1 / this of the fastest one's time is as good, so that runs repeat
# Variables of the environment that keep libraries from instruction sets which the processor has.
LIMITS = ("ONEDNN_MAX_CPU_ISA", "ATEN_CPU_CAPABILITY")
# Values of the first that leave the bfloat16 units in use.
WITH_UNITS = ("BF16", "FP16", "AMX", "AVX10", "DEFAULT", "ALL")


@dataclass(frozen=True)
class Precision:
    """What a fit computes in.

    Args:
        trainer: "32-true" or "bf16-mixed", or another that Lightning's ``trainer.precision`` takes.
        memory_format: of the pictures in the encoder, "channels_last" or "contiguous".
    """

    trainer: str = FLOAT32
    memory_format: str = "channels_last"


def has_bfloat16_units(device: torch.device) -> bool:
    """Whether ``device`` multiplies bfloat16 in hardware, and is allowed to."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    limit = os.environ.get("ONEDNN_MAX_CPU_ISA", "DEFAULT").upper()
    return (
        device.type == "cpu"
        and torch.backends.mkldnn.is_available()
        and torch.ops.mkldnn._is_mkldnn_bf16_supported()
        and any("bf16" in flag for flag in cpu_flags())
        and any(word in limit for word in WITH_UNITS)
    )


def candidates(device: torch.device) -> list[Precision]:
    """What may be fastest on ``device``, the likeliest first."""
    formats = [BFLOAT16, FLOAT32] if has_bfloat16_units(device) else [FLOAT32]
    return [Precision(number, memory) for number in formats for memory in MEMORY_FORMATS]


def choose(encoder: nn.Module | None, device: torch.device) -> Precision:
    """The fastest of :func:`candidates` for training ``encoder`` on ``device``, measured in about a second.

    Args:
        encoder: has ``embed`` for what its ``normalize`` makes of uint8 frames [N, *frame_shape]; it is not changed.
            None, or an encoder without these, gives the likeliest choice without a measurement.
        device: of the training.
    """
    if not all(hasattr(encoder, name) for name in ("frame_shape", "normalize", "embed")):
        return candidates(device)[0]
    seconds = seconds_a_step(encoder, candidates(device), device)
    return next(choice for choice in seconds if seconds[choice] <= min(seconds.values()) / ALIKE)


def seconds_a_step(encoder: nn.Module, choices: list[Precision], device: torch.device) -> dict[Precision, float]:
    """Seconds that the encoder's forward and backward pass takes in each of ``choices``, the least of several turns.

    On a CPU they are those of one thread while it computes, which other programs hardly change.
    """
    generator = torch.Generator().manual_seed(0)
    frames = torch.randint(0, 256, (STACKS, *encoder.frame_shape), dtype=torch.uint8, generator=generator)
    patches = encoder.normalize(frames.to(next(encoder.parameters()).device)).to(device)
    encoders = {
        memory: copy.deepcopy(encoder).requires_grad_().train().to(device, memory_format=MEMORY_FORMATS[memory])
        for memory in {choice.memory_format for choice in choices}
    }

    def step(choice: Precision) -> float:
        start = _now(device)
        with torch.autocast(device.type, torch.bfloat16, enabled=choice.trainer == BFLOAT16):
            embedding = encoders[choice.memory_format].embed(patches)
        embedding.square().sum().backward()
        return _now(device) - start

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        # the first steps choose and compile kernels
        while step(choices[0]) > BUDGET_S / 4 and len(patches) > 2:
            patches = patches[: len(patches) // 2]
        for choice in choices[1:]:
            step(choice)
        seconds: dict[Precision, list[float]] = {choice: [] for choice in choices}
        for turn in range(MOST_TURNS):
            if turn >= LEAST_TURNS and sum(map(sum, seconds.values())) > BUDGET_S:
                break
            for choice in choices:
                seconds[choice].append(step(choice))
    finally:
        torch.set_num_threads(threads)
    return {choice: min(times) for choice, times in seconds.items()}


def _now(device: torch.device) -> float:
    if device.type == "cpu":
        return time.thread_time()
    torch.accelerator.synchronize(device)
    return time.perf_counter()


def memory_format_of(module: nn.Module) -> str:
    """The name of the format in which the module's pictures are; "channels_last" of one without convolutions."""
    kernels = [weight for weight in module.parameters() if weight.ndim == 4 and weight[0, 0].numel() > 1]
    last = not kernels or kernels[0].is_contiguous(memory_format=torch.channels_last)
    return "channels_last" if last else "contiguous"


def describe(precision: Precision, device: torch.device) -> str:
    """The choice and what it was made for, in a line."""
    if device.type == "cuda":
        where = torch.cuda.get_device_name(device)
    else:
        where = f"{processor()} ({' '.join(cpu_flags()) or platform.machine()}), {torch.get_num_threads()} threads"
    limits = [f"{name}={os.environ[name]}" for name in LIMITS if name in os.environ]
    return ", ".join([f"{precision.trainer}, {precision.memory_format}, on {where}", *limits])
