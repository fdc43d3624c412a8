"""The radio of an experiment, as plain values that a recipe can give."""

from __future__ import annotations

from dataclasses import dataclass, field

from tsjepa.radio import Deployment, GilbertElliott, IidLoss, units_per_slot
from tsjepa.radio.belief import check_csi
from tsjepa.radio.urgency import UrgencyCode
from tsjepa.support.checks import at_least, within

FULL_BANDWIDTH_MHZ = 20.0


@dataclass(frozen=True)
class Requests:
    """How devices tell the base station of their urgency, in every slot.

    Args:
        bits: of a request.
        smallest: urgency below which a device says that it needs nothing, as a part of the actuator's range.
        full_scale: urgency of the last code; the codes between are even in decibels.
        delay: slots until a request counts.
    """

    bits: int = 4
    smallest: float = 0.005
    full_scale: float = 1.0
    delay: int = 1

    def __post_init__(self) -> None:
        self.code()
        at_least(0, delay=self.delay)

    def code(self) -> UrgencyCode:
        """The code of a request."""
        return UrgencyCode(self.bits, self.full_scale, smallest=self.smallest)


@dataclass(frozen=True)
class Radio:
    """The uplink that the devices share.

    What differs between devices is a list that is dealt out to them in turn: with 3 values device 3 has the first one.

    Args:
        resource_blocks: J, devices that may transmit in a slot; None lets each take as many resource units as its
            payload and channel need.
        payload_bits: bits that the scheduler reserves for an update where ``resource_blocks`` is None, one number or a
            list; None takes them from the codec, which is possible unless the codec's packets vary in length.
        bandwidth_mhz: where ``resource_blocks`` is None: of 20 MHz, whose 106 resource blocks shrink in proportion.
        codec: of what is sent, see :func:`tsjepa.radio.codecs.make_codec`; a frame codec sends frames and leaves
            the encoder to the controller.
        quality: of JPEG and WebP, 1 to 100; of H.264 the constant rate factor, 0 to 51, lower is better.
        snr_target_db: mean SNR that power control gives every device, one number or a list; None transmits at
            ``tx_power_dbm``.
        tx_power_dbm: fixed transmit power.
        snr_threshold_db: SNR below which a packet is lost.
        csi: what the scheduler knows of the channel: "perfect", "delayed", "statistical", or "acks" alone.
        csi_delay: slots by which delayed knowledge lags.
        max_doppler_hz: 0 for fading that is independent from slot to slot.
        deployment: positions and propagation.
        loss: packet loss beside the SNR.
        lossless: everything that is scheduled arrives, and no channel is computed.
        priority: list of weights > 0 by which schedulers that compute a device's gain multiply it; None: all alike.
        requests: how devices tell their urgency, for the scheduler "urgency" and for functions that read it.
    """

    resource_blocks: int | None = 10
    payload_bits: int | tuple[int, ...] | None = None
    bandwidth_mhz: float = FULL_BANDWIDTH_MHZ
    codec: str = "fp32"
    quality: int = 50
    snr_target_db: float | tuple[float, ...] | None = 10.0
    tx_power_dbm: float = 23.0
    snr_threshold_db: float = 5.0
    csi: str = "perfect"
    csi_delay: int = 1
    max_doppler_hz: float = 0.0
    deployment: Deployment = field(default_factory=Deployment)
    loss: IidLoss | GilbertElliott | None = None
    lossless: bool = False
    priority: tuple[float, ...] | None = None
    requests: Requests | None = None

    def __post_init__(self) -> None:
        check_csi(self.csi, self.csi_delay)
        at_least(0, max_doppler_hz=self.max_doppler_hz)
        within(-200, 200, tx_power_dbm=self.tx_power_dbm, snr_threshold_db=self.snr_threshold_db)
        for value in _each(self.snr_target_db):
            within(-200, 200, snr_target_db=value)
        for name in ("resource_blocks", "payload_bits"):
            for value in _each(getattr(self, name)):
                at_least(1, **{name: value})
        if not all(value > 0 for value in _each(self.priority)):
            raise ValueError(f"priority {self.priority} holds a weight that is not above 0")

    def units(self, slot: float) -> int:
        """Resource units in a slot of ``slot`` seconds: whole ones, at least 1."""
        return max(1, int(units_per_slot(slot) * self.bandwidth_mhz / FULL_BANDWIDTH_MHZ))


def _each(value: float | tuple[float, ...] | None) -> tuple[float, ...]:
    return () if value is None else tuple(value) if isinstance(value, tuple | list) else (value,)
