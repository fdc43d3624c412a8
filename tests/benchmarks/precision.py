"""The chosen precision and memory format beside the others, in one run: a whole training step of the main job in each.

python tests/benchmarks/precision.py --threads 2
ONEDNN_MAX_CPU_ISA=AVX2 ATEN_CPU_CAPABILITY=avx2 python tests/benchmarks/precision.py --output FILE
"""

import argparse
import statistics
import time

import torch
from report import publish, spread

from tsjepa.data.augmentation import Augmentation
from tsjepa.models import Encoder, Predictor
from tsjepa.support.allocator import keep_freed_memory
from tsjepa.support.precision import BFLOAT16, FLOAT32, MEMORY_FORMATS, Precision, choose, describe
from tsjepa.training.jepa import TSJEPA

WINDOWS, STACKS = 32, 8  # of a step of recipes/jepa.yaml
ENCODER = {"widths": (32, 64, 128), "embedding_dim": 64, "grey": True, "stem_kernel": 1}  # as there
TARGET = 0.95


class Step(TSJEPA):
    """The main job's module, which takes steps without a trainer."""

    global_step = 0

    def log_terms(self, *args) -> None:
        pass


def make_step(precision: Precision, device: torch.device):
    """A function that takes one optimizer step in the given precision."""
    torch.manual_seed(0)
    encoder = Encoder(**ENCODER)
    module = Step(encoder, Predictor(64, 512), Augmentation()).to(device)
    module.to(memory_format=MEMORY_FORMATS[precision.memory_format]).train()
    optimizer = module.optimizer([part for part in module.parameters() if part.requires_grad])
    height, width = encoder.height // 4, encoder.width // 4
    patches = torch.randint(0, 256, (WINDOWS, STACKS, height, width, 96), dtype=torch.uint8, device=device)
    batch = {"patches": patches, "commands": torch.randn(WINDOWS, STACKS - 1, 1, device=device)}

    def step() -> float:
        start = time.perf_counter()
        with torch.autocast(device.type, torch.bfloat16, enabled=precision.trainer == BFLOAT16):
            loss = module.training_step(batch, 0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        module.on_train_batch_end(None, batch, 0)
        if device.type == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter() - start

    return step


def measure(rounds: int) -> dict:
    """Steps of the four in turns."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    keep_freed_memory()
    chosen = choose(Encoder(**ENCODER), device)
    every = [Precision(trainer, memory) for trainer in (BFLOAT16, FLOAT32) for memory in MEMORY_FORMATS]
    steps = {precision: make_step(precision, device) for precision in every}
    for step in steps.values():
        step()
    seconds = {precision: [] for precision in every}
    for _ in range(rounds):
        for precision, step in steps.items():
            # an emulated format takes seconds a step: a few of those are enough
            if len(seconds[precision]) < 3 or statistics.median(seconds[precision]) < 2:
                seconds[precision].append(step())
    fastest = min(every, key=lambda precision: statistics.median(seconds[precision]))
    ratio = statistics.median(seconds[fastest]) / statistics.median(seconds[chosen])
    return {
        "computes_in": describe(chosen, device),
        "threads": torch.get_num_threads(),
        "chosen": vars(chosen),
        "fastest": vars(fastest),
        "seconds_a_step": {
            f"{precision.trainer}, {precision.memory_format}": spread(times) for precision, times in seconds.items()
        },
        "fastest_over_chosen": {"ratio": ratio, "target": TARGET},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", default="docs/results/precision.json")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    publish(options.output, measure(options.rounds))


if __name__ == "__main__":
    main()
