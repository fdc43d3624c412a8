"""What is sent, and what arrives."""

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import (
    SlotTransform,
    Values,
    active_rows,
    flag_spec,
    number_spec,
    require_key,
    scatter_rows,
    select,
)
from tsjepa.envs.transforms.channel import device_index
from tsjepa.radio.age import next_age
from tsjepa.radio.codecs import payload_bits
from tsjepa.radio.link import DECODE_THRESHOLD_DB, db_to_linear, resource_units
from tsjepa.radio.links import McsLink
from tsjepa.radio.streams import uniform
from tsjepa.radio.video import FrameStream

AT_CONTROLLER = ("delivered", "age_of_information")
AT_BASE_STATION = ("decoded", "decoded_age")
"""Keys of outcome and age: of what the controller has, and of what the base station has passed on to it."""


class Codec(SlotTransform):
    """Encodes and decodes the update of each scheduled device.

    Writes ``payload`` (what the receiver would make of it, same shape as the input, zeros where nothing is sent) and
    ``payload_bits`` (int64, the bits of the real packet, 0 where nothing is sent).

    Args:
        codec: one of ``tsjepa.radio.codecs``.
        in_key: what is sent: "embedding", "state" or "pixels".
    """

    def __init__(self, codec: nn.Module, in_key: str = "embedding"):
        super().__init__(in_keys=[in_key], out_keys=["payload", "payload_bits"])
        self.codec = codec

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        spec = require_key(incoming, self.in_keys[0], "Codec", "the transform that makes it")
        return {"payload": spec.clone(), "payload_bits": number_spec(incoming, dtype=torch.int64)}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        rows = active_rows(current, "scheduled", fresh)
        if isinstance(self.codec, FrameStream):
            if not bool(rows.all()):
                raise ValueError(
                    "A codec of streams sends what is new since the slot before, so every device has to send in every "
                    "slot: choose a codec without 'stream-', or as many resource_blocks as there are devices."
                )
            if fresh is not None:
                self.codec.restart()
        source = require_key(current, self.in_keys[0], "Codec", "the transform that makes it")
        packets = self.codec.encode(source[rows])
        decoded = self.codec.decode(packets).to(source)
        return {
            "payload": scatter_rows(rows, decoded),
            "payload_bits": scatter_rows(rows, payload_bits(packets).to(source.device)),
        }


class Uplink(SlotTransform):
    """Decides which updates arrive, and counts the age of what the controller knows.

    An update arrives if it is scheduled, its SNR is enough, no loss model erases it, and it fits into the resource
    units that were granted; each condition applies where the chain has the transform that writes it. The SNR is enough
    if it reaches the threshold or, with an MCS, with the probability that its block error rate leaves. Where a
    :class:`Channel` writes ``repeated_snr``, what is not decoded at once is sent again in the slot, and the two SNRs
    add (a loss model erases both).

    Writes ``delivered`` (bool) and ``age_of_information`` (int64: 1 on delivery, else one more; a device joins with an
    age of 1 before its first slot), or the ``keys`` given. With ``in_key`` also ``received``: the update where one
    arrived; elsewhere the last one that did ("hold"), or zeros ("drop"); zeros until the first. With a repetition also
    ``transmissions`` (int64): 0, 1 or 2.

    Args:
        snr_threshold_db: decode threshold.
        aoi_reset: "delivery", or "scheduled" for the age as printed, which also resets when the packet is lost.
        in_key: the payload to hand over, or None.
        when_lost: "hold" or "drop".
        lossless: everything that is scheduled arrives.
        mcs: the link whose block error rate decides instead of the threshold, or None.
        demand: from bits and linear SNR to the resource units that an update needs.
        keys: names of outcome and age; :data:`AT_BASE_STATION` where a :class:`Delay` follows.
        repeats: whether a :class:`Channel` writes ``repeated_snr``.
        seed: of the block errors.
    """

    def __init__(
        self,
        snr_threshold_db: float = DECODE_THRESHOLD_DB,
        aoi_reset: str = "delivery",
        in_key: str | None = "payload",
        when_lost: str = "hold",
        lossless: bool = False,
        mcs: McsLink | None = None,
        demand: Callable[[Tensor, Tensor], Tensor] = resource_units,
        keys: tuple[str, str] = AT_CONTROLLER,
        repeats: bool = False,
        seed: int = 0,
    ):
        if aoi_reset not in ("delivery", "scheduled"):
            raise ValueError(f"unknown aoi_reset {aoi_reset!r}: choose 'delivery' or 'scheduled'")
        if when_lost not in ("hold", "drop"):
            raise ValueError(f"unknown when_lost {when_lost!r}: choose 'hold' or 'drop'")
        self.carried = keys + (("received",) if in_key else ())
        out_keys = [*self.carried, "transmissions"] if repeats else [*self.carried]
        super().__init__(in_keys=[in_key] if in_key else [], out_keys=out_keys)
        self.snr_threshold = float(db_to_linear(snr_threshold_db))
        self.aoi_reset = aoi_reset
        self.when_lost = when_lost
        self.lossless = lossless
        self.mcs, self.demand = mcs, demand
        self.keys, self.repeats = keys, repeats
        self.seed = seed

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        outcome, age = self.keys
        specs = {outcome: flag_spec(incoming), age: number_spec(incoming, dtype=torch.int64)}
        if self.in_keys:
            specs["received"] = self._payload(incoming).clone()
        if self.repeats:
            specs["transmissions"] = number_spec(incoming, dtype=torch.int64)
        return specs

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        shape, device = current.batch_size, current.device
        outcome, age = self.keys
        start = {
            outcome: torch.zeros(shape, dtype=torch.bool, device=device),
            age: torch.ones(shape, dtype=torch.int64, device=device),
        }
        if self.in_keys:
            start["received"] = torch.zeros_like(self._payload(current))
        return start

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        outcome, age = self.keys
        scheduled = active_rows(current, "scheduled", None)
        delivered = scheduled if self.lossless else scheduled & self._decodable(current)
        refreshed = delivered if self.aoi_reset == "delivery" else scheduled
        values = {outcome: delivered, age: next_age(previous[age], refreshed)}
        if self.in_keys:
            payload, last = self._payload(current), previous["received"]
            values["received"] = select(
                delivered, payload, last if self.when_lost == "hold" else torch.zeros_like(last)
            )
        if self.repeats:
            again = scheduled & ~self._enough(current, current["snr"].to(torch.float64))
            values["transmissions"] = scheduled.to(torch.int64) + again
        return values

    def _payload(self, container: Composite | TensorDictBase) -> TensorSpec | Tensor:
        return require_key(container, self.in_keys[0], "Uplink", "a Codec (or set in_key=None)")

    def _decodable(self, current: TensorDictBase) -> Tensor:
        decodable = torch.ones(current.batch_size, dtype=torch.bool, device=current.device)
        keys = set(current.keys())
        if "snr" in keys:
            snr = current["snr"].to(torch.float64)
            decodable = self._enough(current, snr + current["repeated_snr"] if self.repeats else snr)
        if "erased" in keys:
            decodable = decodable & ~current["erased"]
        if {"resource_units", "payload_bits", "snr"} <= keys:
            # what is decoded with its repetition had units for the threshold, as the scheduler asks for no more
            snr = current["snr"].to(torch.float64)
            needed = self.demand(current["payload_bits"], snr.clamp(min=self.snr_threshold) if self.repeats else snr)
            decodable = decodable & (needed <= current["resource_units"])
        return decodable

    def _enough(self, current: TensorDictBase, snr: Tensor) -> Tensor:
        """Whether a packet is decoded at ``snr``, bool [*B]; what is decoded at one SNR is so at every higher one."""
        if self.mcs is None:
            return snr >= self.snr_threshold
        counters = (current["channel_episode"], current["channel_slot"])
        return uniform(self.seed, "decoding", device_index(current), *counters) > self.mcs.error_rate(
            current["payload_bits"], snr
        )
