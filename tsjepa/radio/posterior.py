"""The probability that a transmission is decoded, given what is known of a Rayleigh link.

A packet is decoded when its SNR reaches a threshold. The SNR is exponential with a known mean, and its fading in two
slots has the correlation rho (that of the complex gain). All SNRs and thresholds are linear; results are float64.
"""

import math

import numpy as np
import torch
from scipy.special import j0
from torch import Tensor

_TAIL = 8.0
_NODES, _WEIGHTS = (0.5 * _TAIL * x for x in np.polynomial.legendre.leggauss(20))


def fading_correlation(lag_s: Tensor | float, max_doppler_hz: float) -> Tensor:
    """Correlation of the fading at two instants ``lag_s`` apart: J0(2 pi f_D lag) of Clarke's (Jakes') spectrum.

    ``max_doppler_hz`` 0 stands for fading that is independent from slot to slot, as in ``Channel``: 1 at lag 0, else 0.
    Computed by SciPy, since ``torch.special.bessel_j0`` is off by 3e-7 beyond an argument of 5.
    """
    lag = torch.as_tensor(lag_s, dtype=torch.float64)
    if max_doppler_hz < 0 or bool((lag < 0).any()):
        raise ValueError(f"the Doppler shift ({max_doppler_hz:g} Hz) and the lag must be at least 0")
    if max_doppler_hz == 0:
        return (lag == 0).to(torch.float64)
    return torch.as_tensor(j0(2 * math.pi * max_doppler_hz * lag.cpu().numpy()), device=lag.device)


def marcum_q1(a: Tensor, b: Tensor) -> Tensor:
    """Marcum's Q function of order 1: P[X > b^2] of a noncentral chi-square X, 2 degrees, noncentrality a^2.

    The density x exp(-(x - a)^2 / 2) exp(-a x) I0(a x) is integrated over the side of b on which it falls off, 8 units
    wide, by Gauss and Legendre's rule with 20 nodes: absolute error below 1e-12.

    Args:
        a, b: >= 0, broadcast together.

    Returns:
        float64, the broadcast shape.
    """
    a, b = torch.broadcast_tensors(torch.as_tensor(a, dtype=torch.float64), torch.as_tensor(b, dtype=torch.float64))
    nodes = torch.as_tensor(_NODES + 0.5 * _TAIL, device=a.device)
    weights = torch.as_tensor(_WEIGHTS, device=a.device)
    above = b >= a
    width = torch.where(above, _TAIL, b.clamp(max=_TAIL))
    start = torch.where(above, b, b - width)
    x = start.unsqueeze(-1) + width.unsqueeze(-1) / _TAIL * nodes
    centre = a.unsqueeze(-1)
    density = x * torch.exp(-0.5 * (x - centre) ** 2) * torch.special.i0e(centre * x)
    mass = width / _TAIL * (density * weights).sum(-1)
    return torch.where(above, mass, 1.0 - mass).clamp(0.0, 1.0)


def statistical_success(threshold: Tensor | float, mean_snr: Tensor) -> Tensor:
    """P[snr >= threshold], the mean alone being known: exp(-threshold / mean)."""
    return torch.exp(-torch.as_tensor(threshold, dtype=torch.float64) / mean_snr.to(torch.float64))


def delayed_success(
    threshold: Tensor | float, mean_snr: Tensor, old_snr: Tensor, correlation: Tensor | float
) -> Tensor:
    """P[snr >= threshold | an older SNR]: Q1(sqrt(2 rho^2 g_old / s), sqrt(2 g_th / s)) with s = (1 - rho^2) g_mean.

    The link's gain given the older one is complex Gaussian around rho times it; the phase drops out (Rice). With
    rho = 0 the older SNR says nothing, and the result is :func:`statistical_success` to the bit; with rho = 1 it says
    all.

    Args:
        threshold: g_th.
        mean_snr: g_mean > 0, broadcast with the rest.
        old_snr: g_old; negative where there is no measurement yet, which leaves the statistical probability.
        correlation: rho between then and now.
    """
    mean, old, square = _arguments(mean_snr, old_snr, correlation)
    threshold = torch.as_tensor(threshold, dtype=torch.float64, device=mean.device)
    blind = (square == 0) | (old < 0)
    exact = (square >= 1) & ~blind
    spread = torch.where(exact, 1.0, 1.0 - square) * mean
    probability = marcum_q1(
        torch.sqrt(torch.where(blind | exact, 0.0, 2 * square * old / spread)), torch.sqrt(2 * threshold / spread)
    )
    probability = torch.where(exact, (old >= threshold).to(torch.float64), probability)
    return torch.where(blind, statistical_success(threshold, mean), probability)


def expected_snr(mean_snr: Tensor, old_snr: Tensor, correlation: Tensor | float) -> Tensor:
    """E[snr | an older SNR] = rho^2 g_old + (1 - rho^2) g_mean; the mean where ``old_snr`` is negative."""
    mean, old, square = _arguments(mean_snr, old_snr, correlation)
    return torch.where(old < 0, mean, square * old + (1.0 - square) * mean)


def success_after(
    threshold: Tensor | float, mean_snr: Tensor, above_then: Tensor, correlation: Tensor | float
) -> Tensor:
    """P[snr >= threshold | how probably it was above some slots ago], as an ACK tells.

    With h = threshold / mean and t = sqrt(2 h / (1 - rho^2)), both SNRs are above with probability
    exp(-h) (1 + Q1(rho t, t) - Q1(t, rho t)) (the bivariate Rayleigh law, Schwartz, Bennett and Stein, 1966).

    Args:
        threshold, mean_snr: as above.
        above_then: probability that the SNR was above then, given the outcome: 1 after an ACK.
        correlation: rho between then and now.
    """
    mean, then, square = _arguments(mean_snr, above_then, correlation)
    h = torch.as_tensor(threshold, dtype=torch.float64, device=mean.device) / mean
    alone = torch.exp(-h)
    t = torch.sqrt(2 * h / torch.where(square < 1, 1.0 - square, 1.0))
    rho = torch.sqrt(square)
    stays = torch.where(square < 1, 1.0 + marcum_q1(rho * t, t) - marcum_q1(t, rho * t), 1.0)
    # P[above] = P[above then] P[stays] + P[below then] P[comes back] holds for the law itself, then = alone
    comes_back = alone * (1.0 - stays) / (1.0 - alone).clamp(min=1e-300)
    probability = (then * stays + (1.0 - then) * comes_back).clamp(0.0, 1.0)
    return torch.where(square == 0, alone, probability)


def _arguments(mean_snr: Tensor, other: Tensor, correlation: Tensor | float) -> tuple[Tensor, Tensor, Tensor]:
    mean = torch.as_tensor(mean_snr, dtype=torch.float64)
    rho = torch.as_tensor(correlation, dtype=torch.float64, device=mean.device)
    return torch.broadcast_tensors(mean, torch.as_tensor(other, dtype=torch.float64), rho**2)
