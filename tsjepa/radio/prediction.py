"""Linear prediction of a fading gain from its last measured values."""

from functools import cache

import torch
from torch import Tensor

from tsjepa.radio.posterior import fading_correlation, marcum_q1

_RIDGE = 1e-6  # keeps the normal equations of slow fading solvable, whose lags are nearly alike


@cache
def gain_predictor(lags: int, delay: int, max_doppler_hz: float, slot_s: float) -> tuple[Tensor, Tensor]:
    """Weights of the last measured gains in the best linear prediction of this slot's, and the variance that it leaves.

    The gain is a complex Gaussian process of variance 1 with the correlation J0(2 pi f_D lag). The weights a solve the
    Wiener and Hopf equations R a = r, with R the correlations between the measured slots and r those with this slot;
    1 - 2 a r + a R a is left. With one measurement that is a = rho and 1 - rho^2.

    Args:
        lags: how many measurements there are at most, the newest ``delay`` slots old.
        delay: at least 1.
        max_doppler_hz, slot_s: of the fading and the slots.

    Returns:
        Weights [lags + 1, lags], row n for n measurements and newest first; variances [lags + 1], 1 in row 0. float64.
    """
    distance = torch.arange(lags + delay, dtype=torch.float64) * slot_s
    rho = fading_correlation(distance, max_doppler_hz)
    slots = torch.arange(lags)
    between, to_now = rho[(slots[:, None] - slots).abs()], rho[slots + delay]
    weights, left = torch.zeros(lags + 1, lags, dtype=torch.float64), torch.ones(lags + 1, dtype=torch.float64)
    for n in range(1, lags + 1):
        a = torch.linalg.solve(between[:n, :n] + _RIDGE * torch.eye(n), to_now[:n])
        weights[n, :n] = a
        left[n] = 1.0 - 2.0 * a @ to_now[:n] + a @ between[:n, :n] @ a
    return weights, left.clamp(min=1e-9)


def predicted_success(threshold: Tensor | float, mean_snr: Tensor, predicted_power: Tensor, variance: Tensor) -> Tensor:
    """P[snr >= threshold] of a gain that is complex Gaussian around its prediction (Rice).

    Args:
        threshold: linear SNR.
        mean_snr: linear, > 0.
        predicted_power: |prediction|^2, in units of the mean power.
        variance: what the prediction leaves, in (0, 1].
    """
    height = torch.as_tensor(threshold, dtype=torch.float64, device=mean_snr.device) / mean_snr.to(torch.float64)
    return marcum_q1(torch.sqrt(2 * predicted_power / variance), torch.sqrt(2 * height / variance))
