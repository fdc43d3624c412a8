"""What a fleet experiment is made of: the radio that is shared, and the plants."""

from __future__ import annotations

from dataclasses import dataclass, field

from tsjepa.evaluation.closed_loop import Starts
from tsjepa.radio import Deployment, GilbertElliott, IidLoss, units_per_slot
from tsjepa.radio.simulation import check_csi
from tsjepa.support.checks import at_least, within


@dataclass(frozen=True)
class Radio:
    """The uplink that the devices share.

    Args:
        resource_blocks: J, devices that may transmit in a slot; None lets each take as many resource units as its
            payload and channel need (paper-notes, decision 16).
        payload_bits: bits that the scheduler reserves for an update where ``resource_blocks`` is None; None takes
            them from the codec, which is possible unless the codec's packets vary in length.
        bandwidth_mhz: where ``resource_blocks`` is None: of 20 MHz, whose 106 resource blocks shrink in proportion.
        codec: of what is sent, see :func:`tsjepa.radio.codecs.make_codec`; a frame codec sends frames and leaves
            the encoder to the controller.
        snr_target_db: mean SNR that power control gives every device; None transmits at ``tx_power_dbm``.
        tx_power_dbm: fixed transmit power.
        snr_threshold_db: SNR below which a packet is lost.
        csi: what the scheduler knows of the channel: "perfect", "delayed" or "statistical".
        csi_delay: slots by which delayed knowledge lags.
        max_doppler_hz: 0 for fading that is independent from slot to slot.
        deployment: positions and propagation.
        loss: packet loss beside the SNR.
        lossless: everything that is scheduled arrives.
    """

    resource_blocks: int | None = 10
    payload_bits: int | None = None
    bandwidth_mhz: float = 20.0
    codec: str = "fp32"
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

    def units(self, sampling_interval: float) -> int:
        """Resource units in a slot, at least 1."""
        return max(1, int(units_per_slot(sampling_interval) * self.bandwidth_mhz / 20.0))


@dataclass(frozen=True)
class Plants:
    """The cart-poles, their controller apart.

    Args:
        slots: length of the episode that is scored.
        sampling_interval: seconds per slot.
        process_noise_std: of the noise on both velocities after every slot, m/s and rad/s.
        frame_history: frames before and including step 0, the warm-up under zero force.
    """

    slots: int = 100
    sampling_interval: float = 0.02
    process_noise_std: float = 0.008
    frame_history: int = 2

    def __post_init__(self) -> None:
        at_least(1, slots=self.slots, frame_history=self.frame_history)
        at_least(0, process_noise_std=self.process_noise_std)
        within(1e-6, 10, sampling_interval=self.sampling_interval)

    def starts(self, seed: int, count: int) -> Starts:
        """Starts of the devices 0 .. count - 1; device i is the same plant whatever ``count`` is."""
        return Starts(seed, count, self.slots, self.frame_history, self.sampling_interval, self.process_noise_std)
