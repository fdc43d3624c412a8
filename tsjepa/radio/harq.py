"""One retransmission, whose signal is added to the first one's (hybrid ARQ with chase combining).

Maximum-ratio combining of two copies of a packet adds their SNRs. With a decode threshold, a packet is lost after both
attempts if the sum stays below it.
"""

import torch
from torch import Tensor


def residual_outage(snr_threshold: Tensor | float, first_mean: Tensor | float, second_mean: Tensor | float) -> Tensor:
    """P[both attempts fail] under independent Rayleigh fading: P[g1 + g2 < threshold] of two exponentials.

    (m1 (1 - exp(-t / m1)) - m2 (1 - exp(-t / m2))) / (m1 - m2), and 1 - (1 + t / m) exp(-t / m) for equal means.

    Args:
        snr_threshold: t, linear, >= 0.
        first_mean, second_mean: mean SNRs m1 and m2, linear, > 0; broadcast against the threshold.

    Returns:
        float64.
    """
    arguments = (torch.as_tensor(x, dtype=torch.float64) for x in (snr_threshold, first_mean, second_mean))
    threshold, first, second = torch.broadcast_tensors(*arguments)
    if not bool((threshold >= 0).all()) or not bool(((first > 0) & (second > 0)).all()):
        raise ValueError("give the threshold (>= 0) and both mean SNRs (> 0) as linear ratios, not in dB")
    high, low = torch.maximum(first, second), torch.minimum(first, second)
    # exp(-t / high) (1 + (low / x) (1 - exp(-x t / (high low)))) with x = high - low is stable as x goes to 0
    gap = high - low
    slope = threshold / (high * low)
    grown = torch.where(gap * slope > 1e-12, -torch.expm1(-gap * slope) / gap.clamp(min=1e-300), slope)
    return (1.0 - torch.exp(-threshold / high) * (1.0 + low * grown)).clamp(min=0.0)
