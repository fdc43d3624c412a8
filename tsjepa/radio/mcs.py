"""Modulation and coding of 5G NR: the table up to 64QAM, transport-block sizes, and the block error rate.

The block error rate is the normal approximation (Polyanskiy, Poor and Verdu, 2010, without its term in log n) for QAM
symbols with equal probabilities, shifted by a gap for the code and the receiver. It is no measured curve: measured ones
of NR's LDPC codes differ from it by some tenths of a decibel, which the gap is there to absorb.
"""

import math
from functools import cache

import numpy as np
import torch
from torch import Tensor

MODULATION_ORDER = torch.tensor([2] * 10 + [4] * 7 + [6] * 12)
"""Q_m, bits per symbol, of MCS 0 to 28 (TS 38.214 Table 5.1.3.1-1)."""
_RATES = (
    *(120, 157, 193, 251, 308, 379, 449, 526, 602, 679),
    *(340, 378, 434, 490, 553, 616, 658),
    *(438, 466, 517, 567, 616, 666, 719, 772, 822, 873, 910, 948),
)
CODE_RATE = torch.tensor(_RATES, dtype=torch.float64) / 1024
"""R of MCS 0 to 28 (the same table, which prints 1024 R)."""
SPECTRAL_EFFICIENCY = MODULATION_ORDER * CODE_RATE
"""Information bits per symbol of MCS 0 to 28, float64."""

_SIZES = (
    *(*range(24, 193, 8), *range(208, 385, 16), *range(408, 577, 24), *range(608, 769, 32), *range(808, 929, 40)),
    *(984, 1032, 1064, 1128, *range(1160, 1353, 32), 1416, *range(1480, 1929, 64), 2024, *range(2088, 2281, 64)),
    *(2408, *range(2472, 2857, 64), 2976, 3104, 3240, 3368, 3496, 3624, 3752, 3824),
)
SMALL_BLOCKS = torch.tensor(_SIZES)
"""Transport-block sizes of at most 3824 bits (TS 38.214 Table 5.1.3.2-1)."""
GAP_DB = 1.0
_GRID_DB = (-30.0, 50.0, 0.1)


def transport_block_bits(
    mcs: Tensor | int, resource_blocks: Tensor | int, symbols: int = 14, overhead: int = 12
) -> Tensor:
    """Bits of one transport block on one layer (TS 38.214, 5.1.3.2; the uplink's 6.1.4.2 is the same).

    Args:
        mcs: 0 to 28.
        resource_blocks: blocks of 12 subcarriers, at least 1, broadcast against ``mcs``.
        symbols: OFDM symbols in the slot.
        overhead: resource elements per block that carry no data: reference signals, and the configured overhead.

    Returns:
        int64, the broadcast shape.
    """
    mcs, blocks = torch.broadcast_tensors(_checked(mcs), torch.as_tensor(resource_blocks))
    elements = min(156, 12 * symbols - overhead) * blocks
    rate = CODE_RATE.to(mcs.device)[mcs]
    information = elements * rate * MODULATION_ORDER.to(mcs.device)[mcs]
    table = SMALL_BLOCKS.to(mcs.device)
    step = 2.0 ** (torch.log2(information.clamp(min=1)).floor() - 6).clamp(min=3)
    small = (step * (information / step).floor()).clamp(min=24)
    small = table[torch.searchsorted(table, small.contiguous()).clamp(max=len(table) - 1)]
    step = 2.0 ** (torch.log2((information - 24).clamp(min=1)).floor() - 5)
    # the standard rounds halves up, torch.round to even
    large = (step * ((information - 24) / step + 0.5).floor()).clamp(min=3840) + 24
    limit = torch.where(rate <= 0.25, 3816.0, 8424.0)
    segments = torch.where(large - 24 > torch.where(rate <= 0.25, 0.0, 8424.0), (large / limit).ceil(), 1.0)
    large = 8 * segments * (large / (8 * segments)).ceil() - 24
    return torch.where(information <= 3824, small, large.to(torch.int64))


def block_error_rate(mcs: Tensor | int, snr: Tensor, bits: Tensor | int, gap_db: float = GAP_DB) -> Tensor:
    """Probability that a block of ``bits`` is not decoded: Q((n C - bits) / sqrt(n V)) with n = bits / efficiency.

    C and V are mutual information and dispersion of the MCS's constellation, at ``snr`` lowered by the gap.

    Args:
        mcs: 0 to 28.
        snr: linear; broadcast against ``mcs`` and ``bits``.
        bits: information bits in the block, >= 1.
        gap_db: what code and receiver lose against the approximation.

    Returns:
        float64, the broadcast shape.
    """
    mcs = _checked(mcs).to(snr.device)
    db = 10 * torch.log10(snr.to(torch.float64).clamp(min=1e-12)) - gap_db
    bits = torch.as_tensor(bits, dtype=torch.float64, device=snr.device)
    mcs, db, bits = torch.broadcast_tensors(mcs, db, bits)
    low, high, step = _GRID_DB
    place = ((db - low) / step).clamp(0, round((high - low) / step) - 1e-9)
    index, share = place.floor().to(torch.int64), place - place.floor()
    row = MODULATION_ORDER.to(mcs.device)[mcs] // 2 - 1
    information, dispersion = (
        table.to(mcs.device)[row, index] * (1 - share) + table.to(mcs.device)[row, index + 1] * share
        for table in _curves()
    )
    symbols = bits / SPECTRAL_EFFICIENCY.to(mcs.device)[mcs]
    margin = (symbols * information - bits) / torch.sqrt(symbols * dispersion.clamp(min=1e-12))
    return 0.5 * torch.erfc(margin / math.sqrt(2))


def highest_mcs(snr: Tensor, bits: Tensor | int, target: float = 0.1, gap_db: float = GAP_DB) -> Tensor:
    """The highest MCS whose block error rate is at most ``target``, int64; 0 where none is."""
    if not 0 < target < 1:
        raise ValueError(f"the target block error rate {target:g} must lie between 0 and 1")
    bits = torch.as_tensor(bits, device=snr.device).unsqueeze(-1)
    rates = block_error_rate(torch.arange(29, device=snr.device), snr.unsqueeze(-1), bits, gap_db)
    return ((rates <= target) * torch.arange(29, device=snr.device)).amax(-1)


@cache
def _curves() -> tuple[Tensor, Tensor]:
    """Mutual information (bits) and dispersion (bits^2) per symbol of QPSK, 16QAM and 64QAM over the grid of SNRs.

    Square QAM is two independent amplitude modulations with half the noise each; the mean over the noise is Gauss and
    Hermite's rule with 48 nodes.
    """
    low, high, step = _GRID_DB
    snr = 10 ** (np.arange(low, high + step / 2, step) / 10)
    nodes, weights = np.polynomial.hermite.hermgauss(48)
    information, dispersion = [], []
    for order in (2, 4, 8):
        points = 2.0 * np.arange(order) - order + 1
        points /= np.sqrt(2 * (points**2).mean())
        gap = points[:, None] - points[None, :]
        scaled = np.sqrt(snr)[:, None, None, None] * gap[None, :, :, None]
        # log2 of p(y | x) / p(y), for every sent point and every node of the noise
        density = np.log2(order) - np.logaddexp.reduce(-(scaled**2) - 2 * scaled * nodes, axis=2) / math.log(2)
        weight = weights / np.sqrt(np.pi) / order
        mean = (density * weight).sum((1, 2))
        information.append(2 * mean)
        dispersion.append(2 * ((density**2 * weight).sum((1, 2)) - mean**2))
    return torch.from_numpy(np.stack(information)), torch.from_numpy(np.stack(dispersion))


def _checked(mcs: Tensor | int) -> Tensor:
    mcs = torch.as_tensor(mcs)
    if bool(((mcs < 0) | (mcs > 28)).any()):
        raise ValueError("an MCS index lies outside 0 to 28 (29 to 31 are reserved for retransmissions)")
    return mcs
