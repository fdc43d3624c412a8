"""Device-steps per second of a fleet that renders and encodes every slot, and what encoding it as one batch gains.

    python tests/benchmarks/fleet.py --threads 2            # about three minutes on an idle machine

- fleet: ``FleetEnv``, the network's ``Camera`` and ``Encode`` as one TorchRL environment, every device in every slot,
  against the number of devices; beside it the same pictures drawn and encoded with nothing around them;
- encoding: the frames of the whole fleet in one call, in float32 and in bfloat16 under autocast, beside one call a
  device in float32; and how far the embeddings of bfloat16 are from those of float32.

The floor under both is the encoder's FLOPs, counted while it runs, at the rate at which the same number of threads
multiplies large float32 matrices in the same round.
"""

import argparse
import time

import torch
from report import publish, spread
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

import tsjepa
from tsjepa.support.allocator import keep_freed_memory

GEMM_SIDE = 1024
TARGET_BATCHED = 3  # times one by one
TARGET_OF_FLOOR = 0.9  # of what the FLOPs allow, which counts as at the limit


def flops_per_observation(model: torch.nn.Module, frames: Tensor) -> int:
    """Floating-point operations of encoding one of ``frames``; a multiplication with its addition counts as two."""
    with FlopCounterMode(display=False) as counter:
        model.encode(frames[:1])
    return counter.get_total_flops()


def gemm_rate(matrix: Tensor) -> float:
    """FLOP/s of a product of square matrices."""
    start = time.perf_counter()
    matrix @ matrix
    return 2 * len(matrix) ** 3 / (time.perf_counter() - start)


def build(devices: int, model: torch.nn.Module, plant):
    """The environment: plants, camera, encoder."""
    from torchrl.envs import Compose, TransformedEnv

    from tsjepa.envs import FleetEnv
    from tsjepa.envs.transforms import Camera, Encode

    plants = FleetEnv(plant, devices, 10**9, model.frame_history, terminate_on_failure=False)
    camera = Camera(plant.render, plant.spec.frame, model.frame_stack, model.frame_spacing)
    return TransformedEnv(plants, Compose(camera, Encode(model.encode)))


def run(env, law, slots: int) -> tuple[float, list[Tensor]]:
    """Seconds that ``slots`` steps take from fresh starts, and the scenes [I, frame_history, s] of each."""
    now, seen = env.reset(), []
    start = time.perf_counter()
    for _ in range(slots):
        now = env.step(now.set("action", law(now["state"])))["next"]
        seen.append(now["scene"])
    return time.perf_counter() - start, seen


def alone(model: torch.nn.Module, plant, seen: list[Tensor]) -> float:
    """Seconds that drawing and encoding the same pictures takes."""
    start = time.perf_counter()
    for history in seen:
        scenes = history[:, :: model.frame_spacing]
        pictures = torch.from_numpy(plant.render(scenes.flatten(0, 1).numpy()))
        model.encode(pictures.unflatten(0, scenes.shape[:2]))
    return time.perf_counter() - start


def seconds_to_encode(model: torch.nn.Module, frames: Tensor, rows: int, precision: torch.dtype) -> float:
    """Seconds of encoding ``frames`` [I, ...], so many rows a call."""
    start = time.perf_counter()
    with torch.autocast("cpu", precision, enabled=precision is not torch.float32):
        for part in frames.split(rows):
            model.encode(part)
    return time.perf_counter() - start


def least_agreement(model: torch.nn.Module, frames: Tensor) -> float:
    """Smallest cosine between the embeddings of ``frames`` in bfloat16 and in float32."""
    exact = model.encode(frames)
    with torch.autocast("cpu", torch.bfloat16):
        return torch.nn.functional.cosine_similarity(model.encode(frames), exact).min().item()


@torch.no_grad()
def measure(name: str, sizes: list[int], batch: int, rounds: int, steps: int, threads: int) -> dict:
    """All contenders in turn, after a round that does not count.

    Args:
        name: zoo entry.
        sizes: numbers of devices of the fleets.
        batch: number of devices whose frames are encoded in both ways.
        rounds: turns of each.
        steps: device-steps of a fleet and turn, at least one slot.
        threads: of torch; recorded.
    """
    from tsjepa.plants import CartPole

    model = tsjepa.load(name)
    plant = CartPole(model.spec.slot)
    law = plant.experts()[plant.normaliser]
    fleets = {size: build(size, model, plant) for size in sizes}
    frames = build(batch, model, plant).reset()["pixels"]
    matrix = torch.randn(GEMM_SIDE, GEMM_SIDE, generator=torch.Generator().manual_seed(0))
    flops = flops_per_observation(model, frames)
    chained, drawn = {size: [] for size in sizes}, {size: [] for size in sizes}
    ways = {"batched": (batch, torch.float32), "bfloat16": (batch, torch.bfloat16), "one_by_one": (1, torch.float32)}
    encoded, peak = {way: [] for way in ways}, []
    for turn in range(rounds + 1):
        measured = {}
        for size, env in fleets.items():
            slots = max(1, steps // size)
            took, seen = run(env, law, slots)
            measured[size] = (slots * size / took, slots * size / alone(model, plant, seen))
        seconds = {way: seconds_to_encode(model, frames, *options) for way, options in ways.items()}
        rate = gemm_rate(matrix)
        if turn:
            for size, (fleet, bare) in measured.items():
                chained[size].append(fleet)
                drawn[size].append(bare)
            for way, took in seconds.items():
                encoded[way].append(batch / took)
            peak.append(rate)
    return {
        "model": name,
        "threads": threads,
        "encoder_megaflop": flops / 1e6,
        "frame_bytes_per_observation": frames[0].numel(),
        "gemm_gigaflop_per_second": spread([rate / 1e9 for rate in peak]),
        "fleet": [
            {
                "devices": size,
                "device_steps_per_second": spread(chained[size]),
                "drawing_and_encoding_alone_per_second": spread(drawn[size]),
                "fleet_over_alone": spread(ratios(chained[size], drawn[size])),
                "fleet_over_encoder_floor": spread(shares(chained[size], peak, flops)),
            }
            for size in sizes
        ],
        "encoding": {
            "devices": batch,
            "target_over_one_by_one": TARGET_BATCHED,
            "target_over_floor": TARGET_OF_FLOOR,
            "least_cosine_of_bfloat16": least_agreement(model, frames),
            "one_by_one_per_second": spread(encoded["one_by_one"]),
            **{
                way: {
                    "per_second": spread(encoded[way]),
                    "over_one_by_one": spread(ratios(encoded[way], encoded["one_by_one"])),
                    "over_float32_floor": spread(shares(encoded[way], peak, flops)),
                }
                for way in ("batched", "bfloat16")
            },
        },
    }


def ratios(ours: list[float], theirs: list[float]) -> list[float]:
    """Of the same rounds."""
    return [a / b for a, b in zip(ours, theirs, strict=True)]


def shares(rates: list[float], peak: list[float], flops: int) -> list[float]:
    """Observations per second over what the FLOPs alone would allow, round by round."""
    return [rate * flops / limit for rate, limit in zip(rates, peak, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="tsjepa-cartpole")
    parser.add_argument("--devices", type=int, nargs="+", default=[1, 16, 64, 256], help="I of the fleets")
    parser.add_argument("--batch", type=int, default=64, help="I of the encoding")
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--steps", type=int, default=512, help="device-steps a fleet and round")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", default="docs/results/fleet.json")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    keep_freed_memory()  # as the program's commands do
    publish(
        options.output,
        measure(options.model, options.devices, options.batch, options.rounds, options.steps, options.threads),
    )


if __name__ == "__main__":
    main()
