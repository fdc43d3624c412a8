"""What the radio's own computing costs: the pure network mode beside an older checkout, and schedulers that watch.

    python tests/benchmarks/radio.py --beside ../tsjepa-of-before      # two minutes

- network: device-slots per second of one thread under channel_aware, I = 1000, in turns with the checkout ``--beside``
  (its ``simulate_ages``), each in a process of its own; left out without it;
- fleet: device-steps per second against I, from pixels with ``--model``, 10 blocks: under channel_aware only what is
  sent is drawn and encoded, under urgency every device draws and encodes in every slot.

Seconds are those of the processor (all threads of the process), so that other work on the machine counts little.
"""

import argparse
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import torch
from report import publish, spread

import tsjepa
from tsjepa.envs import Radio
from tsjepa.evaluation.conditions import plant_of
from tsjepa.evaluation.rollouts import Loop, run

HERE = Path(__file__).parents[2]
TARGET = 0.95  # of the other checkout's speed
SCHEDULERS = ("channel_aware", "expected_urgency", "urgency")
TURN = """
import sys, time, torch
try:
    from tsjepa.radio import simulate_ages
except ImportError:
    from tsjepa.network import simulate_ages  # as the package was called at first
torch.set_num_threads(1)
for line in sys.stdin:
    start = time.process_time()
    simulate_ages("channel_aware", 1000, 50, int(line), batch=50, seed=0)
    print(50 * 1000 * int(line) / (time.process_time() - start), flush=True)
"""


def contender(checkout: Path) -> subprocess.Popen:
    """A process that simulates as many slots as each line says with the package of a checkout, and answers its rate."""
    place = os.environ | {"PYTHONPATH": str(checkout)}
    return subprocess.Popen(
        [sys.executable, "-c", TURN], cwd=checkout, env=place, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )


def rate(process: subprocess.Popen, slots: int) -> float:
    """Device-slots per second of one turn."""
    print(slots, file=process.stdin, flush=True)
    return float(process.stdout.readline())


def network(other: Path, rounds: int, slots: int) -> dict:
    """Rates of both checkouts, and the ratio of ours to the other's in each round."""
    both = [contender(HERE), contender(other)]
    turns = [[rate(process, slots) for process in both] for _ in range(rounds + 1)][1:]
    for process in both:
        process.stdin.close()
        process.wait()
    ours, theirs = zip(*turns, strict=True)
    commit = subprocess.run(["git", "-C", other, "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout
    return {
        "other_commit": commit.strip(),
        "ours": spread(list(ours)),
        "other": spread(list(theirs)),
        "ours_over_other": spread([our / their for our, their in turns]) | {"target": TARGET},
    }


def steps_per_second(loop: Loop) -> float:
    """Device-steps per second of the processor in one episode."""
    start = time.process_time()
    run(loop, 0)
    return loop.num_devices * loop.slots / (time.process_time() - start)


def fleet(model, sizes: list[int], slots: int, rounds: int) -> list[dict]:
    """One row a fleet size: rates by scheduler, and urgency's to channel_aware's in each round."""
    rows = []
    for size in sizes:
        base = Loop(plant_of(model, None), model, num_devices=size, slots=slots, radio=Radio(resource_blocks=10))
        loops = {name: replace(base, scheduler=name) for name in SCHEDULERS}
        turns = [[steps_per_second(loop) for loop in loops.values()] for _ in range(rounds + 1)][1:]
        rates = {name: spread(list(own)) for name, own in zip(loops, zip(*turns, strict=True), strict=True)}
        ratio = spread([turn[-1] / turn[0] for turn in turns])
        rows.append({"devices": size, "device_steps_per_second": rates, "urgency_over_channel_aware": ratio})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beside", type=Path, help="another checkout of this repository")
    parser.add_argument("--model", default="tsjepa-cartpole-d16", help="an entry of the zoo")
    parser.add_argument("--devices", type=int, nargs="+", default=[10, 40, 160])
    parser.add_argument("--slots", type=int, default=20, help="of each fleet")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--network-slots", type=int, default=100, help="of each turn of the pure network mode")
    parser.add_argument("--output", default="docs/results/radio.json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    model = tsjepa.load(options.model)
    result = {"model_sha256": model.entry_sha256, "network": {"left_out": "no other checkout was given (--beside)"}}
    if options.beside is not None:
        result["network"] = network(options.beside.resolve(), options.rounds, options.network_slots)
    result["fleet"] = fleet(model, options.devices, options.slots, options.rounds)
    publish(options.output, result)


if __name__ == "__main__":
    main()
