"""What an update costs a device in joules."""

from dataclasses import dataclass

import torch
from torch import Tensor

from tsjepa.radio.link import db_to_linear


def energy_per_update(
    tx_power_dbm: Tensor | float,
    duration_s: Tensor | float,
    encode_j: Tensor | float = 0.0,
    circuit_w: float = 0.0,
    amplifier_efficiency: float = 1.0,
) -> Tensor:
    """Joules of one update, transmitted once: encode + duration (P / efficiency + circuit).

    Args:
        tx_power_dbm: radiated power P; 23 dBm are 0.2 W.
        duration_s: time on the air; a retransmission counts again.
        encode_j: camera and encoder, for the picture that was sent.
        circuit_w: what the radio draws beside its amplifier while it transmits.
        amplifier_efficiency: radiated over drawn power, in (0, 1].

    Returns:
        float64, the arguments broadcast together.
    """
    if not 0 < amplifier_efficiency <= 1:
        raise ValueError(f"amplifier_efficiency {amplifier_efficiency:g} must lie in (0, 1]")
    duration = torch.as_tensor(duration_s, dtype=torch.float64)
    encode = torch.as_tensor(encode_j, dtype=torch.float64)
    if bool((duration < 0).any()) or bool((encode < 0).any()) or circuit_w < 0:
        raise ValueError("duration_s, encode_j and circuit_w must be at least 0")
    radiated_w = db_to_linear(tx_power_dbm) / 1e3
    return encode + duration * (radiated_w / amplifier_efficiency + circuit_w)


@dataclass(frozen=True)
class EnergyModel:
    """What a device draws.

    Args:
        encode_j: camera and encoder, for each picture: of devices that watch, in every slot, else of those that send.
        circuit_w: the radio beside its amplifier, while it transmits.
        amplifier_efficiency: radiated over drawn power, in (0, 1].
        airtime_s: of one transmission where no resource units are counted; else a unit lasts a millisecond.
    """

    encode_j: float = 0.0
    circuit_w: float = 0.0
    amplifier_efficiency: float = 1.0
    airtime_s: float = 1e-3

    def __post_init__(self) -> None:
        self.joules(0.0, self.airtime_s)

    def joules(self, tx_power_dbm: Tensor | float, airtime_s: Tensor | float) -> Tensor:
        """Joules of an update that is ``airtime_s`` on the air, see :func:`energy_per_update`."""
        return energy_per_update(tx_power_dbm, airtime_s, self.encode_j, self.circuit_w, self.amplifier_efficiency)
