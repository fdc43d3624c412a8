"""Laws of the cart-pole that were searched for, for slots of 20 ms, a pole of 1 m and forces within 20 N."""

from __future__ import annotations

from typing import NamedTuple


class Law(NamedTuple):
    """Numbers of a :class:`tsjepa.plants.bent_lqr.BentLQR`.

    Args:
        gain: N per m, rad, m/s, rad/s.
        position_clip: m.
        terms: newtons of a saturating term, then what is in it of x, theta, x_dot and theta_dot.
    """

    gain: tuple[float, float, float, float]
    position_clip: float
    terms: tuple[tuple[float, float, float, float, float], ...]


# tests/benchmarks/search_expert.py: told the true state in every slot
EVERY_SLOT = Law(
    (-40.35, -135.6, -18.39, -32.98),
    0.606,
    (
        (-16.168, -2.470, -3.309, -1.050, -0.444),
        (-15.808, -2.680, -0.939, -1.585, -0.794),
        (-11.270, -2.266, 0.451, -1.368, -0.644),
        (-9.379, -2.379, -2.101, -1.023, -0.230),
        (9.061, -4.545, 13.538, 0.923, 1.715),
        (8.996, 2.513, -3.614, 1.439, 0.931),
        (6.586, 1.707, -0.427, 0.903, 0.037),
        (6.495, -1.132, 3.934, 0.898, 0.716),
        (-6.450, -2.702, -5.560, -0.026, -0.332),
        (5.678, -4.420, 11.964, 0.354, 1.417),
        (-4.365, -1.674, 0.563, -0.875, 0.017),
        (-4.321, -3.129, -3.842, 1.031, -0.949),
        (2.130, -0.586, 3.068, -0.269, -0.597),
        (-1.284, 1.028, -2.755, -0.679, -0.519),
        (-1.160, -1.076, 4.871, -0.327, -0.707),
        (0.401, 0.926, -3.199, -0.226, 0.626),
    ),
)
# tests/benchmarks/search_fleet_law.py: one of 140 devices on a radio, told every 14 slots or so
FLEET = Law(
    (-106.19, -371.02, -83.82, -124.02),
    0.643,
    (
        (16.530, 4.533, 3.632, 1.899, -0.182),
        (-12.850, -0.905, -8.272, -0.735, -0.044),
        (19.016, 2.217, -1.667, 1.079, 0.087),
        (-9.157, -2.645, -1.820, -1.286, -0.043),
    ),
)
