"""How fast the radio and the schedulers are, without a plant.

    python tests/benchmarks/network.py            # two threads, about 20 s

Prints device-slots per second of the pure network mode (channel, scheduler, uplink), its dependence on the number of
devices, the same chain as TorchRL transforms, and, where the package sionna-no-rt is installed, the agreement with and
the speed beside Sionna's 38.901 indoor factory.
"""

import argparse
import math
import time
from concurrent.futures import ThreadPoolExecutor

import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded
from torchrl.envs import Compose, EnvBase, TransformedEnv

from tsjepa.network import Deployment, los_probability, path_loss_db, simulate_ages
from tsjepa.network.deployment import large_scale
from tsjepa.network.transforms import Channel, Scheduler, Uplink


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


def pure(scheduler, num_devices, batch, slots, threads):
    """Device-slots per second: each thread simulates its share of the batch; the best of three runs."""
    shares = [batch // threads + (k < batch % threads) for k in range(threads)]
    shares = [share for share in shares if share]

    def run(count):
        def work(k):
            simulate_ages(scheduler, num_devices, num_devices // 20, count, batch=shares[k], seed=k)

        start = time.perf_counter()
        with ThreadPoolExecutor(len(shares)) as pool:
            list(pool.map(work, range(len(shares))))
        return time.perf_counter() - start

    run(5)
    return batch * num_devices * slots / min(run(slots) for _ in range(3))


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
    """Prints agreement and speed; nothing but a line where Sionna is not installed."""
    try:
        from sionna.phy.channel.tr38901 import InF, PanelArray
    except ImportError:
        print("sionna-no-rt is not installed: comparison left out")
        return
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
        print(
            f"InF-{name}: largest difference {loss_gap:.1e} dB in path loss, {los_gap:.1e} in LoS probability; "
            f"topologies: ours {our_rate:,.0f}, Sionna {their_rate:,.0f} devices/s ({our_rate / their_rate:.0f}x)"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--slots", type=int, default=200)
    arguments = parser.parse_args()
    # one thread per simulation: parallel loops over arrays this small cost more than they gain
    torch.set_num_threads(1)

    print(f"pure network mode, I = 1000, J = 50, B = 100, {arguments.threads} threads, million device-slots/s")
    for scheduler in ("channel_aware", "opportunistic", "round_robin", "max_age", "whittle", "proportional_fair"):
        print(f"  {scheduler:18s} {pure(scheduler, 1000, 100, arguments.slots, arguments.threads) / 1e6:6.1f}")

    print("channel_aware on one thread, B x I = 100,000, ns per device-slot")
    for num_devices in (100, 1000, 10_000, 100_000):
        rate = pure("channel_aware", num_devices, 100_000 // num_devices, arguments.slots, 1)
        print(f"  I = {num_devices:<7d} {1e9 / rate:6.1f}")

    print("TorchRL transforms (Channel, Scheduler, Uplink), I = 1000, one thread, million device-slots/s")
    for batch in (1, 10, 100):
        print(f"  B = {batch:<4d} {transforms(1000, batch, math.ceil(100 / batch)) / 1e6:6.2f}")

    beside_sionna()


if __name__ == "__main__":
    main()
