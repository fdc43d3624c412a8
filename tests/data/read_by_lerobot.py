"""``python tests/data/read_by_lerobot.py FOLDER RESULT.npz``: a data set as LeRobot's own reader gives it, row by row.

Runs in an environment that has ``lerobot[dataset]``, and needs nothing of tsjepa.
"""

import sys
from importlib.metadata import version

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset


def read(folder: str) -> dict[str, np.ndarray]:
    """Pictures uint8 [rows, H, W, 3] and every column of numbers."""
    data = LeRobotDataset("tests/export", root=folder, video_backend="pyav")
    (camera,) = data.meta.camera_keys
    rows = [data[index] for index in range(len(data))]
    numbers = [key for key in rows[0] if key not in (camera, "task")]
    pictures = np.stack([np.asarray(row[camera]).transpose(1, 2, 0) for row in rows])
    return {
        "pixels": (255 * pictures).round().astype(np.uint8),
        "tasks": np.array([row["task"] for row in rows]),
        "version": np.array(version("lerobot")),
        **{key: np.stack([np.asarray(row[key]) for row in rows]) for key in numbers},
    }


if __name__ == "__main__":
    np.savez_compressed(sys.argv[2], **read(sys.argv[1]))
