"""Milliseconds on one core: a device's frames to payload, and the controller's prediction and command for I devices.

    python tests/benchmarks/latency.py                # on an idle machine; needs pip install 'tsjepa[onnx]'

The graphs of `tsjepa deploy` in ONNX Runtime take turns with PyTorch's own modules and with two yardsticks: a large
matrix product, which tells how fast this core multiplies, and the sum of as many numbers as the networks have weights,
which tells how fast it reads them. The floor is the larger of operations at the one rate and bytes at the other.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from report import publish, spread
from torch.utils.flop_counter import FlopCounterMode

import tsjepa
from tsjepa.zoo.deploy import Graph, deploy, graphs

TARGET_MS = {"device": 2.0, "predict": 0.3}  # of one row
GEMM_SIDE = 512
# A device of its own: what a process holds that does nothing but encode.
MEMORY = """
import sys
import numpy, onnxruntime

def peak():  # not ru_maxrss, which a process inherits
    return next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))

before = peak()
options = onnxruntime.SessionOptions()
options.intra_op_num_threads = options.inter_op_num_threads = 1
session = onnxruntime.InferenceSession(sys.argv[1], options, providers=["CPUExecutionProvider"])
place = session.get_inputs()[0]
frames = numpy.zeros([1, *place.shape[1:]], numpy.uint8)
for _ in range(20):
    session.run(None, {place.name: frames})
print(before, peak())
"""


def runtime(path: Path, inputs: dict[str, torch.Tensor]) -> Callable[[], object]:
    """Runs a graph in ONNX Runtime, on one core."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    named = {name: value.numpy() for name, value in inputs.items()}
    return lambda: session.run(None, named)


def example(name: str, graph: Graph, rows: int) -> dict[str, torch.Tensor]:
    """Random inputs of a graph."""
    generator = torch.Generator().manual_seed(0)
    inputs = {name: value[:1].expand(rows, *value.shape[1:]) for name, value in graph.inputs.items()}
    if name == "device":
        return {"frames": torch.randint(0, 256, inputs["frames"].shape, dtype=torch.uint8, generator=generator)}
    embedding = torch.nn.functional.normalize(torch.randn(inputs["embedding"].shape, generator=generator), dim=-1)
    return {"embedding": embedding, "command": torch.linspace(-20, 20, rows)[:, None]}


def parts_of(name: str, model: torch.nn.Module) -> list[torch.nn.Module]:
    """The networks whose weights a graph reads."""
    return [model.encoder] if name == "device" else [model.predictor, model.actor]


@torch.inference_mode()
def measure(path: Path, name: str, graph: Graph, model: torch.nn.Module, rows: int, rounds: int) -> dict:
    """One graph for ``rows`` devices, in milliseconds, beside its floor."""
    inputs = example(name, graph, rows)
    weights = sum(tensor.numel() for part in parts_of(name, model) for tensor in part.parameters())
    with FlopCounterMode(display=False) as counter:
        outputs = graph.module(*inputs.values())
    outputs = outputs if isinstance(outputs, tuple) else (outputs,)
    passed = sum(tensor.nbytes for tensor in (*inputs.values(), *outputs))
    matrix, numbers = torch.randn(GEMM_SIDE, GEMM_SIDE), torch.randn(weights)
    turns = {
        "onnx": runtime(path, inputs),
        "eager": lambda: graph.module(*inputs.values()),
        "gemm": lambda: matrix @ matrix,
        "read": lambda: numbers.sum(),
    }
    times = {turn: [] for turn in turns}
    for round_ in range(-max(2, rounds // 10), rounds):
        for turn, call in turns.items():
            start = time.perf_counter()
            call()
            if round_ >= 0:
                times[turn].append(1e3 * (time.perf_counter() - start))
    flop, read = counter.get_total_flops(), 4 * weights + passed
    floors = [
        max(flop * gemm / (2 * GEMM_SIDE**3), read * sweep / (4 * weights))
        for gemm, sweep in zip(times["gemm"], times["read"], strict=True)
    ]
    return {
        "milliseconds": {turn: spread(times[turn]) for turn in ("onnx", "eager")},
        **({"target_milliseconds": TARGET_MS[name]} if rows == 1 else {}),
        "megaflop": flop / 1e6,
        "megabytes_read": read / 1e6,
        "gemm_gigaflop_per_second": spread([2 * GEMM_SIDE**3 / 1e6 / gemm for gemm in times["gemm"]]),
        "read_gigabytes_per_second": spread([4 * weights / 1e6 / sweep for sweep in times["read"]]),
        "floor_milliseconds": spread(floors),
        "onnx_over_floor": spread([took / floor for took, floor in zip(times["onnx"], floors, strict=True)]),
        "eager_over_onnx": spread([slow / fast for slow, fast in zip(times["eager"], times["onnx"], strict=True)]),
    }


def memory(path: Path) -> dict[str, float]:
    """Peak memory in MiB of a process that only encodes, and of the same before it has loaded the graph."""
    done = subprocess.run([sys.executable, "-c", MEMORY, str(path)], check=True, capture_output=True, text=True)
    before, peak = (int(kibibytes) / 1024 for kibibytes in done.stdout.split())
    return {"peak_mib": peak, "of_which_python_and_onnx_runtime_mib": before}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="tsjepa-cartpole")
    parser.add_argument("--rounds", type=int, default=300, help="a tenth of it for more than 1,000 devices")
    parser.add_argument("--devices", type=int, nargs="+", default=[1, 100, 10_000])
    parser.add_argument("--output", default="docs/results/latency.json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    model = tsjepa.load(options.model)
    parts = graphs(model)
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home) / "graphs"
        deploy(options.model, str(folder))
        result = {
            "model": options.model,
            "threads": 1,
            "payload_bits": 8 * parts["receive"].inputs["payload"].shape[1],
            "frame_bits": 8 * parts["device"].inputs["frames"][0].numel(),
            "device_memory": memory(folder / "device.onnx"),
            "device": measure(folder / "device.onnx", "device", parts["device"], model, 1, options.rounds),
            "controller": {
                str(rows): measure(
                    folder / "predict.onnx",
                    "predict",
                    parts["predict"],
                    model,
                    rows,
                    options.rounds if rows <= 1000 else max(2, options.rounds // 10),
                )
                for rows in options.devices
            },
        }
    publish(options.output, result)


if __name__ == "__main__":
    main()
