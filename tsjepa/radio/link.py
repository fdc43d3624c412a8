"""The radio link: noise, SNR, power control, capacity, outage and resource units."""

import math

import torch
from torch import Tensor

TOTAL_BANDWIDTH_HZ = 20e6
BLOCK_BANDWIDTH_HZ = 180e3
NUM_RESOURCE_BLOCKS = 106
"""Resource blocks of 180 kHz in 20 MHz (TS 38.101-1 Table 5.3.2-1, 15 kHz subcarriers)."""
UNIT_DURATION_S = 1e-3
NOISE_DBM = -95.0
"""Noise over the whole 20 MHz (kTB plus a noise figure of 6 dB, rounded as in the paper's table)."""
DECODE_THRESHOLD_DB = 5.0
"""SNR from which a packet is decoded, where nobody says another."""


def db_to_linear(decibel: Tensor | float) -> Tensor:
    """10^(x / 10), float64."""
    return 10.0 ** (torch.as_tensor(decibel, dtype=torch.float64) / 10.0)


def noise_dbm(bandwidth_hz: float) -> float:
    """Noise power in ``bandwidth_hz``: -95 dBm over 20 MHz, in proportion to the bandwidth."""
    if not bandwidth_hz > 0:
        raise ValueError(f"bandwidth {bandwidth_hz:g} Hz must be positive")
    return NOISE_DBM + 10 * math.log10(bandwidth_hz / TOTAL_BANDWIDTH_HZ)


def mean_snr(path_loss_db: Tensor, tx_power_dbm: Tensor | float, bandwidth_hz: float) -> Tensor:
    """SNR averaged over the fading (the paper's SNR equation with |H|^2 = 1), linear, float64.

    Args:
        path_loss_db: dB with shadowing included, any shape.
        tx_power_dbm: transmit power, broadcast against the path loss.
        bandwidth_hz: bandwidth in use; the noise grows with it.
    """
    loss = torch.as_tensor(path_loss_db, dtype=torch.float64)
    return db_to_linear(tx_power_dbm - loss - noise_dbm(bandwidth_hz))


def sinr(snr: Tensor, rise_db: Tensor | float) -> Tensor:
    """SINR under interference that lifts the noise floor by ``rise_db`` >= 0; both ratios linear, broadcast."""
    if bool((torch.as_tensor(rise_db) < 0).any()):
        raise ValueError("interference cannot lower the noise floor: the rise over thermal must be at least 0 dB")
    return snr / db_to_linear(rise_db).to(snr)


def tx_power_for_target_dbm(path_loss_db: Tensor, snr_target_db: float, bandwidth_hz: float) -> Tensor:
    """Power control: the transmit power in dBm that brings the mean SNR to the target, float64."""
    return snr_target_db + torch.as_tensor(path_loss_db, dtype=torch.float64) + noise_dbm(bandwidth_hz)


def capacity(bandwidth_hz: Tensor | float, snr: Tensor | float) -> Tensor:
    """Shannon capacity W log2(1 + snr) in bit/s (the paper's uplink rate); ``snr`` linear, any shape."""
    snr = torch.as_tensor(snr)
    if not snr.is_floating_point():
        snr = snr.to(torch.float64)
    return bandwidth_hz * torch.log2(1.0 + snr)


def outage_probability(snr_threshold: Tensor | float, mean_snr: Tensor | float) -> Tensor:
    """P[snr < threshold] under Rayleigh fading: 1 - exp(-threshold / mean), the paper's outage equation.

    Args:
        snr_threshold: linear, >= 0.
        mean_snr: linear, > 0; broadcast against the threshold.

    Returns:
        Probability, float64.
    """
    threshold = torch.as_tensor(snr_threshold, dtype=torch.float64)
    mean = torch.as_tensor(mean_snr, dtype=torch.float64)
    if not bool((threshold >= 0).all()):
        raise ValueError("an SNR threshold is negative or not a number: give it as a linear ratio >= 0, not in dB")
    if not bool((mean > 0).all()):
        raise ValueError("a mean SNR is not positive: give it as a linear ratio, not in dB")
    return -torch.expm1(-threshold / mean)


def ergodic_efficiency(mean_snr: Tensor | float) -> Tensor:
    """E[log2(1 + snr)] under Rayleigh fading: e^(1/g) E1(1/g) / ln 2, bit/s/Hz, float64; ``mean_snr`` g > 0 linear."""
    mean = torch.as_tensor(mean_snr, dtype=torch.float64)
    if not bool((mean > 0).all()):
        raise ValueError("a mean SNR is not positive: give it as a linear ratio, not in dB")
    return _scaled_exponential_integral(1.0 / mean) / math.log(2.0)


def resource_units(payload_bits: Tensor | int, snr: Tensor) -> Tensor:
    """Units (one 180 kHz block for 1 ms) that carry the payload: ceil(bits / (180 kHz x 1 ms x log2(1 + snr))).

    Args:
        payload_bits: bits to send, broadcast against ``snr``.
        snr: linear SNR in one block, >= 0.

    Returns:
        int64; a link that no number of units helps (snr = 0) asks for 2^31 - 1.
    """
    bits = torch.as_tensor(payload_bits, device=snr.device).to(torch.float64)
    per_unit = unit_bits(snr)
    needed = torch.where(bits > 0, bits / per_unit, 0.0)
    return needed.ceil().clamp(max=2**31 - 1).to(torch.int64)


def unit_bits(snr: Tensor) -> Tensor:
    """Bits that one resource unit carries at ``snr`` (linear): 622.7 at 10 dB, float64."""
    return capacity(BLOCK_BANDWIDTH_HZ, snr.to(torch.float64)) * UNIT_DURATION_S


def units_per_slot(sampling_interval: float) -> int:
    """Resource units in a slot of ``sampling_interval`` seconds: 106 in each millisecond, 2120 at 20 ms.

    The radio's own slots last 1 ms (TS 38.211, Table 4.3.2-1, 15 kHz subcarriers). Where they do not fit evenly, a slot
    has as many units as it has on average, rounded down: 159 at 1.5 ms, which holds one and two of them in turn.

    Raises:
        ValueError: the slot holds less than one unit.
    """
    units = int(NUM_RESOURCE_BLOCKS * round(sampling_interval / UNIT_DURATION_S, 9))
    if units < 1:
        raise ValueError(f"a slot of {sampling_interval:g} s holds no resource unit: use at least 1 ms")
    return units


def _scaled_exponential_integral(x: Tensor) -> Tensor:
    """e^x E1(x) for x > 0: the power series up to 1, the continued fraction (Abramowitz and Stegun 5.1.22) beyond."""
    small = x.clamp(max=1.0)
    term = torch.ones_like(small)
    series = -0.5772156649015329 - torch.log(small)
    for k in range(1, 25):
        term = term * -small / k
        series = series - term / k
    large = x.clamp(min=1.0)
    fraction = torch.zeros_like(large)
    for k in range(120, 0, -1):
        fraction = k / (1.0 + k / (large + fraction))
    return torch.where(x <= 1.0, torch.exp(small) * series, 1.0 / (large + fraction))
