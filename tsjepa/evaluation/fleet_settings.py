"""What a fleet experiment is made of: the radio that is shared, and the plants."""

from __future__ import annotations

from dataclasses import dataclass, field

from tsjepa.evaluation.closed_loop import Starts
from tsjepa.network import Deployment, GilbertElliott, IidLoss


@dataclass(frozen=True)
class Radio:
    """The uplink that the devices share.

    Args:
        resource_blocks: J, devices that may transmit in a slot; None lets each take as many resource units as its
            payload and channel need (paper-notes, decision 16).
        payload_bits: bits that the scheduler reserves for an update where ``resource_blocks`` is None; None takes
            them from the codec, which is possible unless the codec's packets vary in length.
        codec: of what is sent, see :func:`tsjepa.network.codecs.make_codec`; a frame codec sends frames and leaves
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

    def starts(self, seed: int, count: int) -> Starts:
        """Starts of the devices 0 .. count - 1; device i is the same plant whatever ``count`` is."""
        return Starts(seed, count, self.slots, self.frame_history, self.sampling_interval, self.process_noise_std)
