"""The paper's score and what counts as a failure."""

from __future__ import annotations

import numpy as np

BOX_HALF_WIDTHS = (0.05, 0.05)
FAILURE_LIMITS = (1.8, 0.8)


def in_box(state: np.ndarray) -> np.ndarray:
    """The paper's score: whether |x| <= 0.05 m and |theta| <= 0.05 rad, for states [..., 4] with x_d = 0."""
    return (np.abs(state[..., :2]) <= BOX_HALF_WIDTHS).all(axis=-1)


def has_failed(state: np.ndarray) -> np.ndarray:
    """Whether |x| > 1.8 m or |theta| > 0.8 rad, for states [..., 4]."""
    return (np.abs(state[..., :2]) > FAILURE_LIMITS).any(axis=-1)
