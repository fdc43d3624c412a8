"""Trajectories of equal length from the pieces of a recording, and which of them are held out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tsjepa.data.import_plan import Part
from tsjepa.data.writing import Trajectory

Taken = tuple[Part, int, tuple[int, int]]  # a piece, its first byte in the file of pictures, and their height and width


def split_trajectories(
    taken: list[Taken], raw: Path, size: tuple[int, int], slots: int,
    validation: float, test: float, seed: int,
) -> dict[str, list[Trajectory]]:  # fmt: skip
    """Trajectories by split; pieces are held out whole, or where there are fewer than three, their last stretches."""
    units: list[list[Trajectory]] = []
    for part, start, _ in taken:
        frames = len(part.piece.frame)
        pixels = np.memmap(raw, np.uint8, "r", start, (frames, *size, 3))
        if len(taken) >= 3:
            units.append([_trajectory(part, pixels, first, slots) for first in starts(frames, slots)])
        else:  # stretches that share no picture
            rest = frames % (slots + 1)
            units.append([_trajectory(part, pixels, first, slots) for first in starts(slots + 1 + rest, slots)])
            later = range(slots + 1 + rest, frames, slots + 1)
            units += [[_trajectory(part, pixels, first, slots)] for first in later]
    order = np.arange(len(units))
    if len(taken) >= 3:
        order = np.random.default_rng([seed, 19]).permutation(order)
    held = {}
    for name, share in (("test", test), ("validation", validation)):
        wanted = max(1, round(share * len(units))) if share > 0 else 0
        # of two units one is held out for validation, which a fit asks for
        kept = 1 + (name == "test" and validation > 0)
        wanted = max(0, min(wanted, len(order) - kept))
        held[name], order = sorted(order[len(order) - wanted :]), order[: len(order) - wanted]
    chosen = {"train": sorted(order), "validation": held["validation"], "test": held["test"]}
    return {
        name: [trajectory for place in places for trajectory in units[place]]
        for name, places in chosen.items()
        if len(places)
    }


def starts(frames: int, slots: int) -> list[int]:
    """First frames of the trajectories of a piece: neighbours share one frame, the last overlaps its predecessor."""
    regular = list(range(0, frames - slots, slots))
    return regular if regular[-1] == frames - slots - 1 else [*regular, frames - slots - 1]


def _trajectory(part: Part, pixels: np.ndarray, first: int, slots: int) -> Trajectory:
    rows = slice(first, first + slots + 1)
    action = part.action[rows].copy()
    action[-1] = 0  # its result is not in this trajectory
    trajectory = {"pixels": pixels[rows], "action": action}
    if part.state is not None:
        trajectory["state"] = part.state[rows]
    return trajectory
