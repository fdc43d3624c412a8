"""How fast the radio and the schedulers are, without a plant.

    python tests/benchmarks/network.py            # two threads, about 20 s

Device-slots per second of the pure network mode (channel, scheduler, uplink), in turns with the loop that one would
write in torch; its dependence on the number of devices; the same chain as TorchRL transforms; and, where the package
sionna-no-rt is installed, the agreement with and the speed beside Sionna's 38.901 indoor factory. Writes text beside
the JSON.
"""

import argparse
import math
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import torch
from report import publish, spread
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded
from torchrl.envs import Compose, EnvBase, TransformedEnv

from tsjepa.envs.transforms import Channel, Scheduler, Uplink
from tsjepa.radio import Deployment, los_probability, path_loss_db, simulate_ages
from tsjepa.radio.deployment import large_scale
from tsjepa.support.files import write_text
from tsjepa.support.provenance import provenance


class NoPlant(EnvBase):
    """An environment with nothing in it, to time the transforms alone."""

    def __init__(self, batch_size):
        super().__init__(device="cpu", batch_size=torch.Size(batch_size))
        shape = self.batch_size
        self.observation_spec = Composite(shape=shape)
        self.action_spec = Unbounded((*shape, 1))
        self.reward_spec = Unbounded((*shape, 1))
        self.nothing = TensorDict(
            {"reward": torch.zeros(*shape, 1), "done": torch.zeros(*shape, 1, dtype=torch.bool)}, shape
        )

    def _reset(self, tensordict=None, **kwargs):
        return self.nothing.exclude("reward")

    def _step(self, tensordict):
        return self.nothing.copy()

    def _set_seed(self, seed):
        pass


SCHEDULERS = ("channel_aware", "opportunistic", "round_robin", "max_age", "whittle", "proportional_fair")
ROUNDS = 3


def pure(scheduler, num_devices, batch, slots, threads):
    """Device-slots per second: each thread simulates its share of the batch."""
    shares = [batch // threads + (k < batch % threads) for k in range(threads)]
    shares = [share for share in shares if share]

    def work(k):
        simulate_ages(scheduler, num_devices, blocks(num_devices), slots, batch=shares[k], seed=k)

    start = time.perf_counter()
    with ThreadPoolExecutor(len(shares)) as pool:
        list(pool.map(work, range(len(shares))))
    return batch * num_devices * slots / (time.perf_counter() - start)


def blocks(num_devices):
    """J, a twentieth of I."""
    return max(1, num_devices // 20)


@torch.no_grad()
def plain(num_devices, batch, slots):
    """Device-slots per second of what one would write in torch: Rayleigh fading, the J oldest above the threshold."""
    generator = torch.Generator().manual_seed(0)
    mean_snr, threshold, shape = 10.0, 10**0.5, (batch, num_devices)
    age, ages = torch.ones(shape), []
    start = time.perf_counter()
    for _ in range(slots):
        snr = mean_snr * torch.empty(shape).exponential_(generator=generator)
        chosen = torch.where(snr >= threshold, age, -age).topk(blocks(num_devices)).indices
        scheduled = torch.zeros(shape, dtype=torch.bool).scatter_(1, chosen, True)
        age = torch.where(scheduled & (snr >= threshold), 1.0, age + 1)
        ages.append(age.mean(-1))
    return batch * num_devices * slots / (time.perf_counter() - start)


def in_turns(*contenders):
    """Rates of each after a warm-up, and the ratio of the first to the second within each round."""
    rounds = [[contender() for contender in contenders] for _ in range(ROUNDS + 1)][1:]
    rates = list(zip(*rounds, strict=True))
    return [spread(list(rate)) for rate in rates], spread([turn[0] / turn[1] for turn in rounds])


def transforms(num_devices, batch, slots):
    """Device-slots per second of Channel, Scheduler and Uplink in a TransformedEnv."""
    chain = Compose(
        Channel(snr_target_db=10.0), Scheduler("channel_aware", resource_blocks=num_devices // 20), Uplink(in_key=None)
    )
    env = TransformedEnv(NoPlant((batch, num_devices)), chain)
    tensordict = env.reset().set("action", torch.zeros(batch, num_devices, 1))
    for _ in range(3):
        tensordict = env.step_mdp(env.step(tensordict)).set("action", torch.zeros(batch, num_devices, 1))
    start = time.perf_counter()
    for _ in range(slots):
        tensordict = env.step_mdp(env.step(tensordict)).set("action", torch.zeros(batch, num_devices, 1))
    return batch * num_devices * slots / (time.perf_counter() - start)


def beside_sionna(num_devices=100, repeats=20):
    """Agreement and speed, by scenario; a reason where Sionna is not installed."""
    try:
        from sionna.phy.channel.tr38901 import InF, PanelArray
    except ImportError:
        return {"left_out": "sionna-no-rt is not installed"}
    scenarios = {}
    antenna = dict(
        num_rows_per_panel=1,
        num_cols_per_panel=1,
        polarization="single",
        polarization_type="V",
        antenna_pattern="omni",
        carrier_frequency=3.75e9,
        precision="double",
    )
    for name in ("SL", "DL", "SH", "DH"):
        theirs = InF(
            carrier_frequency=3.75e9,
            ut_array=PanelArray(**antenna),
            bs_array=PanelArray(**antenna),
            direction="uplink",
            factory_scenario=name,
            hall_dimensions=(300.0, 150.0, 12.0),
            clutter_density=0.6,
            clutter_size=2.0,
            clutter_height=3.0,
            precision="double",
        )
        generator = torch.Generator().manual_seed(0)
        place = torch.rand(1, num_devices, 2, generator=generator, dtype=torch.float64) - 0.5
        devices = torch.cat((place * torch.tensor([300.0, 150.0]), torch.full((1, num_devices, 1), 1.5)), -1)
        station = torch.tensor([[[0.0, 0.0, 10.0]]], dtype=torch.float64)
        still = torch.zeros_like(devices)
        topology = (devices, station, still, torch.zeros_like(station), still)
        theirs.set_topology(*topology)
        start = time.perf_counter()
        for _ in range(repeats):
            theirs.set_topology(*topology)
        their_rate = repeats * num_devices / (time.perf_counter() - start)

        deployment, index = Deployment(scenario=name), torch.arange(num_devices)
        large_scale(deployment, 0, index, index)
        start = time.perf_counter()
        for k in range(repeats):
            large_scale(deployment, 0, index, torch.full_like(index, k))
        our_rate = repeats * num_devices / (time.perf_counter() - start)

        scenario = theirs._scenario
        distance = torch.hypot(devices[0, :, 0], devices[0, :, 1])
        loss = path_loss_db(name, torch.hypot(distance, torch.tensor(8.5)), 3.75, scenario.los.flatten())
        loss_gap = (loss - scenario.basic_pathloss.flatten()).abs().max()
        los_gap = (los_probability(name, distance) - scenario.los_probability.flatten()).abs().max()
        scenarios[name] = {
            "largest_difference_db": float(loss_gap),
            "largest_difference_los_probability": float(los_gap),
            "devices_per_second": {"ours": our_rate, "sionna": their_rate},
            "ours_over_sionna": our_rate / their_rate,
        }
    return scenarios


def measure(threads, slots):
    """All of it. One thread per simulation: parallel loops over arrays this small cost more than they gain."""
    torch.set_num_threads(1)
    pure("channel_aware", 1000, 100, 5, threads)
    rates = {name: spread([pure(name, 1000, 100, slots, threads) for _ in range(ROUNDS)]) for name in SCHEDULERS}
    one_thread = {}
    for num_devices in (100, 1000, 10_000, 100_000):
        batch = 100_000 // num_devices
        (ours, theirs), ratio = in_turns(
            lambda i=num_devices, b=batch: pure("channel_aware", i, b, slots, 1),
            lambda i=num_devices, b=batch: plain(i, b, max(1, slots // 4)),
        )
        one_thread[str(num_devices)] = {"ours": ours, "plain_loop": theirs, "ours_over_plain_loop": ratio}
    return {
        "threads": threads,
        "device_slots_per_second": rates,
        "channel_aware_on_one_thread": one_thread,
        "transforms_per_second": {
            str(batch): transforms(1000, batch, math.ceil(100 / batch)) for batch in (1, 10, 100)
        },
        "sionna": beside_sionna(),
    }


def describe(result):
    """The figures as text, medians of three."""
    lines = [f"pure network mode, I = 1000, J = 50, B = 100, {result['threads']} threads, million device-slots/s"]
    for scheduler, rate in result["device_slots_per_second"].items():
        lines.append(f"  {scheduler:18s} {rate['median'] / 1e6:6.1f}")
    lines.append(
        "channel_aware on one thread, B x I = 100,000, ns per device-slot, and the share of a plain loop's time"
    )
    for devices, row in result["channel_aware_on_one_thread"].items():
        ratio = row["ours_over_plain_loop"]["median"]
        lines.append(f"  I = {devices:7s} {1e9 / row['ours']['median']:6.1f} {1 / ratio:6.2f}")
    lines.append("TorchRL transforms (Channel, Scheduler, Uplink), I = 1000, one thread, million device-slots/s")
    lines += [f"  B = {batch:4s} {rate / 1e6:6.2f}" for batch, rate in result["transforms_per_second"].items()]
    sionna = result["sionna"]
    if "left_out" in sionna:
        return [*lines, f"Sionna: {sionna['left_out']}"]
    for name, row in sionna.items():
        rates = row["devices_per_second"]
        lines.append(
            f"InF-{name}: largest difference {row['largest_difference_db']:.1e} dB in path loss, "
            f"{row['largest_difference_los_probability']:.1e} in LoS probability; "
            f"topologies: ours {rates['ours']:,.0f}, Sionna {rates['sionna']:,.0f} devices/s "
            f"({row['ours_over_sionna']:.0f}x)"
        )
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--slots", type=int, default=200)
    parser.add_argument("--output", default="docs/results/network.json")
    options = parser.parse_args()
    result = measure(options.threads, options.slots)
    publish(options.output, result)
    made = provenance()
    head = f"# python tests/benchmarks/{made['command']} at {made['commit']}, {made['date']}; figures in network.json"
    text = "\n".join([head, *describe(result)]) + "\n"
    write_text(Path(options.output).with_suffix(".txt"), text)
    print(text)


if __name__ == "__main__":
    main()
