"""A picture of a data set at a glance."""

from __future__ import annotations

import numpy as np
from tensordict import TensorDict


def contact_sheet(splits: dict[str, TensorDict], columns: int = 6) -> np.ndarray:
    """One row of frames a split, taken at equal distances through its first trajectories; RGB uint8."""
    rows = []
    for split in splits.values():
        episodes, frames = split.batch_size
        picks = [(column % episodes, column * (frames - 1) // max(columns - 1, 1)) for column in range(columns)]
        rows.append(np.concatenate([split["pixels"][pick].numpy() for pick in picks], axis=1))
    return np.concatenate(rows, axis=0)
