"""How many resource units an update takes, and how probably it is lost: Shannon's capacity, or NR's MCS table."""

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from tsjepa.radio.link import db_to_linear, resource_units
from tsjepa.radio.mcs import GAP_DB, SPECTRAL_EFFICIENCY, block_error_rate, highest_mcs, transport_block_bits

_MOST_UNITS = 2**31 - 1
_TABLE_UNITS = 2200
_QUANTILES = 16


@dataclass(frozen=True)
class ShannonLink:
    """Units at capacity, ``gap_db`` away from it; a packet is decoded if and only if its SNR reaches the threshold.

    Args:
        gap_db: SNR that code and receiver need beyond Shannon's capacity, in dB, at least 0.
    """

    gap_db: float = 0.0

    def __post_init__(self) -> None:
        if not self.gap_db >= 0:
            raise ValueError(f"gap_db {self.gap_db:g} must be at least 0 dB: nothing is better than capacity")

    def units(self, bits: Tensor | int, snr: Tensor) -> Tensor:
        """Resource units for ``bits`` at the linear ``snr`` [...], int64."""
        return resource_units(bits, snr if self.gap_db == 0 else snr / db_to_linear(self.gap_db).to(snr.device))


@dataclass(frozen=True)
class McsLink:
    """Transport blocks of TS 38.214 (64QAM table), decoded with the block error rate of their MCS.

    Args:
        mcs: 0 to 28; None takes the highest one whose block error rate meets the target at the SNR that is known.
        target: block error rate that an adapted MCS has to meet.
        gap_db: what code and receiver lose against the curve of :mod:`tsjepa.radio.mcs`, in dB.
    """

    mcs: int | None
    target: float = 0.1
    gap_db: float = GAP_DB

    def __post_init__(self) -> None:
        if self.mcs is not None and not 0 <= self.mcs <= 28:
            raise ValueError(f"mcs {self.mcs} must lie between 0 and 28, or be null for one that follows the SNR")
        if not 0 < self.target < 1:
            raise ValueError(f"the target block error rate {self.target:g} must lie between 0 and 1")

    def units(self, bits: Tensor | int, snr: Tensor) -> Tensor:
        """The fewest resource units whose transport block holds ``bits``, int64, the shape of ``snr`` [...]."""
        needed = torch.broadcast_to(torch.as_tensor(bits, device=snr.device), snr.shape)
        held = _block_bits().to(snr.device)[self._chosen(bits, snr)]
        units = torch.searchsorted(held, needed.to(torch.int64).unsqueeze(-1).contiguous()).squeeze(-1) + 1
        return torch.where(needed > 0, units.masked_fill(units > held.shape[-1], _MOST_UNITS), 0)

    def error_rate(self, bits: Tensor | int, snr: Tensor) -> Tensor:
        """Probability that a block of ``bits`` is not decoded at the linear ``snr`` [...], float64."""
        bits = torch.as_tensor(bits, device=snr.device)
        rate = block_error_rate(self._chosen(bits, snr), snr, bits.clamp(min=1), self.gap_db)
        return torch.where(bits > 0, rate, 0.0)

    def thresholds(self, bits: int) -> tuple[float, ...]:
        """Linear SNRs at which ``bits`` are decoded with a fixed MCS, each as likely: quantiles of the error curve."""
        decibel = torch.arange(-30.0, 50.0, 0.01, dtype=torch.float64)
        rate = self.error_rate(bits, db_to_linear(decibel))
        shares = (torch.arange(_QUANTILES, dtype=torch.float64) + 0.5) / _QUANTILES
        place = torch.searchsorted(1.0 - rate, shares).clamp(max=len(decibel) - 1)
        return tuple(db_to_linear(decibel[place]).tolist())

    def _chosen(self, bits: Tensor | int, snr: Tensor) -> Tensor:
        if self.mcs is None:
            return highest_mcs(snr, torch.as_tensor(bits, device=snr.device).clamp(min=1), self.target, self.gap_db)
        return torch.full(snr.shape, self.mcs, dtype=torch.int64, device=snr.device)


@dataclass(frozen=True)
class AdaptedDecoding:
    """Success of an MCS that follows the slot's SNR, which is known; :class:`tsjepa.radio.decoding.Decoding` else."""

    link: McsLink
    bits: int

    def given_snr(self, snr: Tensor, mean_snr: Tensor) -> Tensor:
        return 1.0 - self.link.error_rate(self.bits, snr.to(torch.float64))


@cache
def _block_bits() -> Tensor:
    """Bits [29, units] of the transport blocks of 1, 2, ... resource units (a block of 180 kHz for 1 ms)."""
    units = torch.arange(1, _TABLE_UNITS + 1)
    # the standard's rounding is not monotone everywhere; a block that fits into fewer units fits into more
    return transport_block_bits(torch.arange(len(SPECTRAL_EFFICIENCY)).unsqueeze(-1), units).cummax(-1).values
