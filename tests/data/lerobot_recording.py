"""A small recording by LeRobot's own writer: the pictures and commands it was given, and the program that gave them.

``python tests/data/lerobot_recording.py FOLDER`` writes it, in an environment that has ``lerobot[dataset]``;
``lerobot_0_6_1`` (format v3.0) and ``lerobot_0_3_3`` (v2.1) beside this file are what those versions wrote.
Needs nothing of tsjepa.
"""

import inspect
import sys

import numpy as np

LENGTHS = (40, 38, 42)  # of the episodes, in rows
RATE_HZ = 20
SIZE = 64


def commands(episode: int) -> np.ndarray:
    """Forces in newtons, float32 [rows, 1]."""
    return np.random.default_rng(episode).uniform(-20, 20, (LENGTHS[episode], 1)).astype(np.float32)


def states(episode: int) -> np.ndarray:
    """Place and height of the spot, 0..1, float32 [rows, 2]; its round lasts longer than any episode."""
    phase = 2 * np.pi * np.arange(LENGTHS[episode]) / 45 + episode
    return (0.5 + 0.3 * np.stack([np.cos(phase), np.sin(phase)], axis=1)).astype(np.float32)


def pictures(episode: int) -> np.ndarray:
    """A soft bright spot on a slope of grey, which is lighter from episode to episode: uint8 [rows, 64, 64, 3]."""
    x, y = SIZE * states(episode).T[:, :, None, None]
    rows, columns = np.mgrid[:SIZE, :SIZE]
    spot = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 50)
    grey = 30 + 20 * episode + 0.5 * columns
    return np.repeat((grey + 120 * spot).round().astype(np.uint8)[..., None], 3, axis=-1)


def write(folder: str) -> None:
    """Records all episodes with LeRobot's defaults."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = {
        "action": {"dtype": "float32", "shape": (1,), "names": ["force_n"]},
        "observation.state": {"dtype": "float32", "shape": (2,), "names": ["place", "height"]},
        "observation.images.front": {
            "dtype": "video", "shape": (SIZE, SIZE, 3), "names": ["height", "width", "channels"],
        },
    }  # fmt: skip
    recording = LeRobotDataset.create("tests/spot", fps=RATE_HZ, features=features, root=folder, robot_type="spot")
    task = {"task": "move the spot"}
    apart = "task" in inspect.signature(recording.add_frame).parameters  # so up to LeRobot 0.3
    for episode in range(len(LENGTHS)):
        for picture, command, state in zip(pictures(episode), commands(episode), states(episode), strict=True):
            row = {"observation.images.front": picture, "action": command, "observation.state": state}
            recording.add_frame(row, **task) if apart else recording.add_frame(row | task)
        recording.save_episode()
    if not apart:
        recording.finalize()


if __name__ == "__main__":
    write(sys.argv[1])
