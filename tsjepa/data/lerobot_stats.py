"""The statistics that LeRobot v3.0 keeps of every feature."""

from __future__ import annotations

import numpy as np

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
LOOKED_AT = 10  # pictures of a trajectory, and every fourth pixel of them: LeRobot estimates them too


class Statistics:
    """Minimum, maximum, mean, standard deviation, quantiles and count, added trajectory by trajectory."""

    def __init__(self) -> None:
        self.rows: dict[str, list[np.ndarray]] = {}
        self.pictures: set[str] = set()

    def add(self, key: str, values: np.ndarray) -> None:
        """Rows [N, width] of a feature."""
        self.rows.setdefault(key, []).append(values.astype(np.float64))

    def add_pictures(self, key: str, pictures: np.ndarray) -> None:
        """Pictures uint8 [N, H, W, 3]; statistics are per channel, in 0..1."""
        picks = np.linspace(0, len(pictures) - 1, min(LOOKED_AT, len(pictures))).astype(int)
        self.rows.setdefault(key, []).append((pictures[picks, ::4, ::4] / 255).reshape(-1, 3).astype(np.float32))
        self.pictures.add(key)

    def summary(self) -> dict[str, dict[str, list]]:
        """Statistics by feature; those of pictures have the shape [3, 1, 1]."""
        found = {}
        for key, parts in self.rows.items():
            rows = np.concatenate(parts)
            values = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
            values |= dict(zip(QUANTILES, np.quantile(rows, list(QUANTILES.values()), axis=0), strict=True))
            shape = (3, 1, 1) if key in self.pictures else (-1,)
            found[key] = {name: np.asarray(value, float).reshape(shape).tolist() for name, value in values.items()}
            found[key]["count"] = [len(rows)]
        return found
