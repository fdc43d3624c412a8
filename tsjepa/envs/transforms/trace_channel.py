"""Radio links as they were measured, in place of simulated ones."""

import math
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, flag_spec, number_spec
from tsjepa.envs.transforms.channel import device_index
from tsjepa.radio.link import db_to_linear, noise_dbm
from tsjepa.radio.streams import uniform
from tsjepa.radio.traces import on_slots, read_trace

SUBCARRIER_HZ = 15e3
"""RSRP is the power of a reference signal in one subcarrier (TS 38.215, 5.1.1)."""


class TraceChannel(SlotTransform):
    """Plays a trace (see :mod:`tsjepa.radio.traces`), device by device.

    Device i of the fleet is device i of the trace; more devices than it has take the same ones again, each round from a
    place of its own. After its last slot a trace goes on with its first one. A gap holds the last value; before the
    first measured SNR a link is too weak for anything, before the first outcome nothing is lost.

    Writes the counters ``channel_episode`` and ``channel_slot``, and of what the trace has: ``snr`` and ``mean_snr``
    (linear, float32; from sinr_db, else snr_db, else rsrp_dbm over the noise of a subcarrier of 15 kHz), ``erased`` and
    ``loss_probability`` (from lost), ``delay_ms`` [*B] float64. The mean SNR is that of the device's whole trace.

    Args:
        path: of the trace.
        sampling_interval: seconds per slot.
        stretch: factor on the time axis of the trace.
        start_s: seconds into the (stretched) trace at which every episode begins; None draws a place for each episode,
            the same for all devices of the trace.
        seed: of the places and of losses that are shares.
    """

    carried = ("channel_episode", "channel_slot")

    def __init__(
        self,
        path: str | Path,
        sampling_interval: float = 0.02,
        stretch: float = 1.0,
        start_s: float | None = None,
        seed: int = 0,
    ):
        values = on_slots(read_trace(path), sampling_interval, stretch).values
        source = next((name for name in ("sinr_db", "snr_db", "rsrp_dbm") if name in values), None)
        columns = ["snr", "mean_snr"] * (source is not None) + ["erased", "loss_probability"] * ("lost" in values)
        columns += ["delay_ms"] * ("delay_ms" in values)
        super().__init__(in_keys=[], out_keys=[*self.carried, *columns])
        self.start = None if start_s is None else round(start_s / sampling_interval)
        self.seed = seed
        self.devices, self.slots = next(iter(values.values())).shape
        if source is not None:
            noise = noise_dbm(SUBCARRIER_HZ) if source == "rsrp_dbm" else 0.0
            snr = db_to_linear((values[source] - noise).nan_to_num(nan=-math.inf))
            known = (~values[source].isnan()).sum(-1).clamp(min=1)
            self.register_buffer("snr", snr)
            # a device that was never measured has a mean that nothing is decoded at, but is no division by zero
            self.register_buffer("mean_snr", (snr.sum(-1) / known).clamp(min=1e-12))
        if "lost" in values:
            self.register_buffer("lost", held(values["lost"]))
        if "delay_ms" in values:
            self.register_buffer("delay_ms", values["delay_ms"].nan_to_num(nan=0.0))

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        specs = {key: number_spec(incoming, dtype=torch.int64) for key in self.carried}
        for key in self.out_keys[2:]:
            dtype = torch.float64 if key == "delay_ms" else torch.float32
            specs[key] = flag_spec(incoming) if key == "erased" else number_spec(incoming, dtype=dtype)
        return specs

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        device = device_index(current)
        episode = before["channel_episode"] + 1 if before else torch.zeros_like(device)
        return {"channel_episode": episode, "channel_slot": torch.full_like(device, -1)}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        device, episode, slot = device_index(current), previous["channel_episode"], previous["channel_slot"] + 1
        return {"channel_episode": episode, "channel_slot": slot} | self.played(device, episode, slot)

    def played(self, device: Tensor, episode: Tensor, slot: Tensor) -> Values:
        """What the trace says of devices in slots of their episodes (int64, broadcast): what it writes but counters."""
        values = {}
        row = device % self.devices
        place = (self._start(device // self.devices, episode) + slot) % self.slots
        if "snr" in self.out_keys:
            values["snr"] = self.snr[row, place].to(torch.float32)
            values["mean_snr"] = self.mean_snr[row].to(torch.float32)
        if "erased" in self.out_keys:
            share = self.lost[row, place]
            values["loss_probability"] = share.to(torch.float32)
            values["erased"] = uniform(self.seed, "trace_loss", device, episode, slot) < share
        if "delay_ms" in self.out_keys:
            values["delay_ms"] = self.delay_ms[row, place]
        return values

    def _start(self, lap: Tensor, episode: Tensor) -> Tensor:
        """Slot of the trace in which an episode begins."""
        drawn = (uniform(self.seed, "trace", lap, episode) * self.slots).to(torch.int64)
        return drawn if self.start is None else torch.where(lap == 0, self.start, drawn)


def held(lost: Tensor) -> Tensor:
    """Outcomes [devices, slots], each slot without one with that of the slot before; 0 before the first."""
    slot = torch.arange(lost.shape[-1]).expand_as(lost)
    last = torch.where(lost.isnan(), -1, slot).cummax(-1).values
    return torch.where(last < 0, 0.0, lost.gather(-1, last.clamp(min=0)))
