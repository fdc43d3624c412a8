"""A fleet that runs on and on needs no more memory than at first.

    python tests/benchmarks/memory.py            # 1,000 devices for 10,000 slots; minutes

Plants, channel, scheduler, uplink and a controller that predicts, with devices that fall and start anew. Prints the
resident memory after a tenth of the slots, its largest value since, and the growth between them in per cent.
"""

import argparse
import os
import time

import torch
from report import publish

from tsjepa.envs.make import LINEAR, make_env, make_policy
from tsjepa.envs.settings import Radio
from tsjepa.plants import CartPole

LOOKS = 100  # at the memory


def resident_bytes() -> int:
    """Resident memory of this process."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@torch.no_grad()
def grow(devices: int, slots: int) -> dict:
    """Steps a fleet and watches the memory."""
    plant, radio = CartPole(), Radio(resource_blocks=max(1, devices // 4))
    env = make_env(plant, devices, "channel_aware", radio, LINEAR, slots=100, terminate_on_failure=True)
    policy = make_policy(plant, LINEAR, radio)
    now, sizes, episodes, began = env.reset(), [], 0, time.monotonic()
    for slot in range(1, slots + 1):
        stepped, now = env.step_and_maybe_reset(policy(now))
        episodes += int(stepped["next", "done"].sum())
        if slot % max(1, slots // LOOKS) == 0:
            sizes.append(resident_bytes())
    early, peak = sizes[len(sizes) // 10], max(sizes[len(sizes) // 10 :])
    return {
        "devices": devices,
        "slots": slots,
        "episodes": episodes,
        "resident_mb_after_a_tenth": round(early / 1e6, 1),
        "largest_mb_since": round(peak / 1e6, 1),
        "growth_percent": round(100 * (peak / early - 1), 3),
        "device_slots_per_second": round(devices * slots / (time.monotonic() - began)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--devices", type=int, default=1000)
    parser.add_argument("--slots", type=int, default=10_000)
    parser.add_argument("--output", default="docs/results/memory.json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    publish(options.output, grow(options.devices, options.slots))


if __name__ == "__main__":
    main()
