"""What is sent, and what arrives."""

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
from tsjepa.radio.age import next_age
from tsjepa.radio.codecs import payload_bits
from tsjepa.radio.link import db_to_linear, resource_units


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
        source = require_key(current, self.in_keys[0], "Codec", "the transform that makes it")
        packets = self.codec.encode(source[rows])
        decoded = self.codec.decode(packets).to(source)
        return {
            "payload": scatter_rows(rows, decoded),
            "payload_bits": scatter_rows(rows, payload_bits(packets).to(source.device)),
        }


class Uplink(SlotTransform):
    """Decides which updates arrive, and counts the age of what the controller knows.

    An update arrives if it is scheduled, its SNR reaches the threshold, no loss model erases it, and it fits into the
    resource units that were granted; each condition applies where the chain has the transform that writes it.

    Writes ``delivered`` (bool) and ``age_of_information`` (int64: 1 on delivery, else one more; a device joins with an
    age of 1 before its first slot). With ``in_key`` also ``received``: the update where one arrived; elsewhere the last
    one that did ("hold"), or zeros ("drop"); zeros until the first.

    Args:
        snr_threshold_db: decode threshold.
        aoi_reset: "delivery", or "scheduled" for the age as printed, which also resets when the packet is lost.
        in_key: the payload to hand over, or None.
        when_lost: "hold" or "drop".
        lossless: everything that is scheduled arrives.
    """

    def __init__(
        self,
        snr_threshold_db: float = 5.0,
        aoi_reset: str = "delivery",
        in_key: str | None = "payload",
        when_lost: str = "hold",
        lossless: bool = False,
    ):
        if aoi_reset not in ("delivery", "scheduled"):
            raise ValueError(f"unknown aoi_reset {aoi_reset!r}: choose 'delivery' or 'scheduled'")
        if when_lost not in ("hold", "drop"):
            raise ValueError(f"unknown when_lost {when_lost!r}: choose 'hold' or 'drop'")
        self.carried = ("delivered", "age_of_information") + (("received",) if in_key else ())
        super().__init__(in_keys=[in_key] if in_key else [], out_keys=list(self.carried))
        self.snr_threshold = float(db_to_linear(snr_threshold_db))
        self.aoi_reset = aoi_reset
        self.when_lost = when_lost
        self.lossless = lossless

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        specs = {
            "delivered": flag_spec(incoming),
            "age_of_information": number_spec(incoming, dtype=torch.int64),
        }
        if self.in_keys:
            specs["received"] = self._payload(incoming).clone()
        return specs

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        shape, device = current.batch_size, current.device
        start = {
            "delivered": torch.zeros(shape, dtype=torch.bool, device=device),
            "age_of_information": torch.ones(shape, dtype=torch.int64, device=device),
        }
        if self.in_keys:
            start["received"] = torch.zeros_like(self._payload(current))
        return start

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        scheduled = active_rows(current, "scheduled", None)
        delivered = scheduled if self.lossless else scheduled & self._decodable(current)
        refreshed = delivered if self.aoi_reset == "delivery" else scheduled
        values = {"delivered": delivered, "age_of_information": next_age(previous["age_of_information"], refreshed)}
        if self.in_keys:
            payload, last = self._payload(current), previous["received"]
            values["received"] = select(
                delivered, payload, last if self.when_lost == "hold" else torch.zeros_like(last)
            )
        return values

    def _payload(self, container: Composite | TensorDictBase) -> TensorSpec | Tensor:
        return require_key(container, self.in_keys[0], "Uplink", "a Codec (or set in_key=None)")

    def _decodable(self, current: TensorDictBase) -> Tensor:
        decodable = torch.ones(current.batch_size, dtype=torch.bool, device=current.device)
        keys = set(current.keys())
        if "snr" in keys:
            decodable = decodable & (current["snr"].to(torch.float64) >= self.snr_threshold)
        if "erased" in keys:
            decodable = decodable & ~current["erased"]
        if {"resource_units", "payload_bits", "snr"} <= keys:
            needed = resource_units(current["payload_bits"], current["snr"].to(torch.float64))
            decodable = decodable & (needed <= current["resource_units"])
        return decodable
