"""The radio of an experiment, as plain values that a recipe can give."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from tsjepa.radio import Deployment, GilbertElliott, IidLoss, units_per_slot
from tsjepa.radio.belief import check_csi
from tsjepa.radio.decoding import Decoding
from tsjepa.radio.delay import ConstantDelay, GammaDelay, RecordedDelay, UniformDelay
from tsjepa.radio.energy import EnergyModel
from tsjepa.radio.link import DECODE_THRESHOLD_DB, db_to_linear
from tsjepa.radio.links import AdaptedDecoding, McsLink, ShannonLink
from tsjepa.radio.posterior import fading_correlation
from tsjepa.radio.urgency import UrgencyCode
from tsjepa.support.checks import at_least, within

FULL_BANDWIDTH_MHZ = 20.0
AnyDelay = ConstantDelay | UniformDelay | GammaDelay | RecordedDelay


@dataclass(frozen=True)
class Downlink:
    """How commands reach the actuator.

    Args:
        loss: probability that a packet of commands is lost.
        delay: of the packets; None delivers them in their slot.
        every: the controller sends in every so many slots: ``every`` - 1 silent slots between two packets.
        buffer: commands in a packet, for its slot and those after it; 1 for a single one, which is held.
        acknowledged: the controller is told which command was applied, and predicts with that.
        horizon: slots; packets that would travel as long or longer are lost.
    """

    loss: float = 0.0
    delay: AnyDelay | None = None
    every: int = 1
    buffer: int = 1
    acknowledged: bool = False
    horizon: int = 16

    def __post_init__(self) -> None:
        within(0, 1, loss=self.loss)
        at_least(1, every=self.every, buffer=self.buffer, horizon=self.horizon)


@dataclass(frozen=True)
class Requests:
    """How devices tell the base station of their urgency.

    Args:
        bits: of a request.
        smallest: urgency below which a device says that it needs nothing, as a part of the actuator's range.
        full_scale: urgency of the last code; the codes between are even in decibels.
        delay: slots until a request counts.
        change: codes by which a device's urgency has to differ from what it said last, 0 after an update, before it
            says so, in a request that also names it: ceil(log2 of the devices) bits more. None: everybody, every slot.
    """

    bits: int = 4
    smallest: float = 0.005
    full_scale: float = 1.0
    delay: int = 1
    change: int | None = None

    def __post_init__(self) -> None:
        self.code()
        at_least(0, delay=self.delay)
        if self.change is not None:
            at_least(1, change=self.change)

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
        link: Shannon's capacity with a gap, at which ``snr_threshold_db`` decides, or the MCS table of NR with its
            block errors; None is capacity without a gap.
        harq_ms: milliseconds until a packet that was not decoded is sent once more within its slot, its SNR added to
            the first one's; None for a single attempt. Grants then have room for two.
        interference_rise_db: by how much interference lifts the noise floor.
        energy: joules of the devices, which results then state; None leaves them out.
        delay: of updates between base station and controller; None delivers them in their slot. "trace" takes the
            delays of the trace.
        delay_horizon: slots; updates that would travel as long or longer are lost.
        ack_loss: probability that whoever schedules does not hear of a delivery, and takes the update for lost.
        downlink: of the commands; None applies each one in its slot.
        trace: file of measured links that replaces the channel's model, see :mod:`tsjepa.radio.traces`.
        trace_stretch: factor on its time axis.
        trace_start_s: seconds into it at which every episode begins; None draws a place.
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
    snr_threshold_db: float = DECODE_THRESHOLD_DB
    csi: str = "perfect"
    csi_delay: int = 1
    max_doppler_hz: float = 0.0
    deployment: Deployment = field(default_factory=Deployment)
    loss: IidLoss | GilbertElliott | None = None
    lossless: bool = False
    link: ShannonLink | McsLink | None = None
    harq_ms: float | None = None
    interference_rise_db: float = 0.0
    energy: EnergyModel | None = None
    delay: AnyDelay | str | None = None
    delay_horizon: int = 16
    ack_loss: float = 0.0
    downlink: Downlink | None = None
    trace: str | None = None
    trace_stretch: float = 1.0
    trace_start_s: float | None = None
    priority: tuple[float, ...] | None = None
    requests: Requests | None = None

    def __post_init__(self) -> None:
        for name in ("bandwidth_mhz", "trace_stretch"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; it has to be a finite number above 0.")
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
        at_least(0, interference_rise_db=self.interference_rise_db)
        at_least(1, delay_horizon=self.delay_horizon)
        within(0, 1, ack_loss=self.ack_loss)
        self._check_link()
        self._check_trace()

    def _check_link(self) -> None:
        if self.harq_ms is not None and not self.harq_ms > 0:
            raise ValueError(f"harq_ms {self.harq_ms:g} must be positive, or null for a single attempt.")
        adapts = isinstance(self.link, McsLink) and self.link.mcs is None
        if adapts and (self.csi != "perfect" or self.resource_blocks is not None or self.harq_ms is not None):
            raise ValueError(
                "An MCS that follows the SNR needs csi perfect, resource_blocks null and no harq_ms; or give link.mcs."
            )
        if self.lossless and self.resource_blocks is None:
            raise ValueError(
                "resource_blocks null asks the channel how much an update takes, and lossless leaves the channel out: "
                "give resource_blocks, or leave lossless out."
            )
        if isinstance(self.link, McsLink) and isinstance(self.payload_bits, (tuple, list)):
            raise ValueError(
                f"payload_bits is {list(self.payload_bits)}: an MCS takes one number of bits for all devices."
            )

    def _check_trace(self) -> None:
        if isinstance(self.delay, str) and (self.delay != "trace" or self.trace is None):
            raise ValueError(f"delay {self.delay!r} is none: give a law, or 'trace' and a trace.")
        if self.trace_start_s is not None:
            at_least(0, trace_start_s=self.trace_start_s)
        beside = self.lossless or self.loss is not None or self.harq_ms is not None or self.interference_rise_db
        if self.trace is not None and beside:
            raise ValueError("A trace is played as it is: leave lossless, loss, harq_ms and interference_rise_db out.")

    def check_fleet(self, num_devices: int) -> None:
        """Refuses a fleet of fewer devices than may transmit in a slot, among whom there is nothing to schedule.

        Raises:
            ValueError: naming both numbers.
        """
        if self.resource_blocks is not None and self.resource_blocks > num_devices:
            raise ValueError(
                f"radio.resource_blocks is {self.resource_blocks} and the fleet has {num_devices} devices: give at "
                f"most {num_devices} resource blocks, or more devices."
            )

    def units(self, slot: float) -> int:
        """Resource units in a slot of ``slot`` seconds: whole ones, at least 1."""
        return max(1, int(units_per_slot(slot) * self.bandwidth_mhz / FULL_BANDWIDTH_MHZ))

    def demand(self, bits: Tensor | int, snr: Tensor) -> Tensor:
        """Resource units that an update of ``bits`` takes at the linear ``snr``, its repetition included, int64."""
        units = (self.link or ShannonLink()).units(bits, snr)
        return units if self.harq_ms is None else (2 * units).clamp(max=2**31 - 1)

    def decoding(self, bits: Any) -> Decoding | AdaptedDecoding:
        """When a packet of ``bits`` is decoded, as whoever schedules believes; only an MCS asks for the bits."""
        if not isinstance(self.link, McsLink):
            thresholds: tuple[float, ...] = (float(db_to_linear(self.snr_threshold_db)),)
        elif self.link.mcs is None:
            return AdaptedDecoding(self.link, bits)
        else:
            thresholds = self.link.thresholds(bits)
        again = None if self.harq_ms is None else float(fading_correlation(1e-3 * self.harq_ms, self.max_doppler_hz))
        return Decoding(thresholds, again)


def _each(value: float | tuple[float, ...] | None) -> tuple[float, ...]:
    return () if value is None else tuple(value) if isinstance(value, tuple | list) else (value,)
