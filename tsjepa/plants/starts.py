"""Where episodes start and what the cart-pole looks like, drawn per device and episode."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tsjepa.plants.streams import CART_COLOR, POLE_COLOR, START, uniforms

DARKEST = 0.25


@dataclasses.dataclass(frozen=True)
class StartDistribution:
    """Uniform start around upright at the origin: half-widths in m, rad, m/s and rad/s.

    Raises:
        ValueError: if a half-width is negative or not finite.
    """

    x: float = 0.8
    theta: float = 0.3
    x_dot: float = 0.3
    theta_dot: float = 0.3

    def __post_init__(self) -> None:
        for name, width in dataclasses.asdict(self).items():
            if not (math.isfinite(width) and width >= 0):
                raise ValueError(f"The start's half-width of {name} must be finite and not negative, got {width!r}.")

    def draw(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """Start states [N, 4] of N (device, episode) pairs; the same pair and seed give the same start."""
        unit = 2.0 * uniforms(seed, START, device, episode, np.zeros(1, np.int64)) - 1.0
        return unit * dataclasses.astuple(self)


def draw_colors(seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
    """Uniform RGB of cart and pole [N, 2, 3] for N (device, episode) pairs, bright enough to show on black."""
    slot = np.zeros(1, np.int64)
    parts = [uniforms(seed, purpose, device, episode, slot)[..., :3] for purpose in (CART_COLOR, POLE_COLOR)]
    return DARKEST + (1.0 - DARKEST) * np.stack(parts, axis=-2)


def noise_std_pair(std: float | tuple[float, float]) -> np.ndarray:
    """Standard deviations (m/s, rad/s) of the velocity noise per slot from one number or a pair.

    Raises:
        ValueError: if one is negative or not finite, or there are not one or two.
    """
    pair = np.asarray(std, np.float64)
    if pair.shape not in ((), (2,)) or not (np.isfinite(pair) & (pair >= 0)).all():
        raise ValueError(f"process_noise_std must be one or two (m/s, rad/s) non-negative numbers, got {std!r}.")
    return np.broadcast_to(pair, (2,))
