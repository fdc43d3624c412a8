"""The radio of an experiment, as plain values that a recipe can give."""

from __future__ import annotations

from dataclasses import dataclass, field

from tsjepa.radio import Deployment, GilbertElliott, IidLoss, units_per_slot
from tsjepa.radio.belief import check_csi
from tsjepa.support.checks import at_least, within

FULL_BANDWIDTH_MHZ = 20.0


@dataclass(frozen=True)
class Radio:
    """The uplink that the devices share.

    Args:
        resource_blocks: J, devices that may transmit in a slot; None lets each take as many resource units as its
            payload and channel need.
        payload_bits: bits that the scheduler reserves for an update where ``resource_blocks`` is None; None takes
            them from the codec, which is possible unless the codec's packets vary in length.
        bandwidth_mhz: where ``resource_blocks`` is None: of 20 MHz, whose 106 resource blocks shrink in proportion.
        codec: of what is sent, see :func:`tsjepa.radio.codecs.make_codec`; a frame codec sends frames and leaves
            the encoder to the controller.
        quality: of JPEG and WebP, 1 to 100; of H.264 the constant rate factor, 0 to 51, lower is better.
        snr_target_db: mean SNR that power control gives every device; None transmits at ``tx_power_dbm``.
        tx_power_dbm: fixed transmit power.
        snr_threshold_db: SNR below which a packet is lost.
        csi: what the scheduler knows of the channel: "perfect", "delayed", "statistical", or "acks" alone.
        csi_delay: slots by which delayed knowledge lags.
        max_doppler_hz: 0 for fading that is independent from slot to slot.
        deployment: positions and propagation.
        loss: packet loss beside the SNR.
        lossless: everything that is scheduled arrives, and no channel is computed.
    """

    resource_blocks: int | None = 10
    payload_bits: int | None = None
    bandwidth_mhz: float = FULL_BANDWIDTH_MHZ
    codec: str = "fp32"
    quality: int = 50
    snr_target_db: float | None = 10.0
    tx_power_dbm: float = 23.0
    snr_threshold_db: float = 5.0
    csi: str = "perfect"
    csi_delay: int = 1
    max_doppler_hz: float = 0.0
    deployment: Deployment = field(default_factory=Deployment)
    loss: IidLoss | GilbertElliott | None = None
    lossless: bool = False

    def __post_init__(self) -> None:
        check_csi(self.csi, self.csi_delay)
        at_least(0, max_doppler_hz=self.max_doppler_hz)
        within(-200, 200, tx_power_dbm=self.tx_power_dbm, snr_threshold_db=self.snr_threshold_db)
        if self.snr_target_db is not None:
            within(-200, 200, snr_target_db=self.snr_target_db)
        for name in ("resource_blocks", "payload_bits"):
            if getattr(self, name) is not None:
                at_least(1, **{name: getattr(self, name)})

    def units(self, slot: float) -> int:
        """Resource units in a slot of ``slot`` seconds: whole ones, at least 1."""
        return max(1, int(units_per_slot(slot) * self.bandwidth_mhz / FULL_BANDWIDTH_MHZ))
