"""Writes trajectories that are there already as a data set; it appears whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict

from tsjepa.data.contact_sheet import contact_sheet
from tsjepa.data.storage import check_space, make_map, publish, write_picture

Trajectory = Mapping[str, np.ndarray]


def write_data_set(
    folder: Path, splits: Mapping[str, Sequence[Trajectory]], metadata: dict, files: Mapping[str, str] | None = None
) -> None:
    """Writes ``folder``, one trajectory in memory at a time.

    Args:
        folder: of the data set; what is there is replaced.
        splits: name to trajectories, each with ``pixels`` uint8 [T + 1, H, W, 3], ``action`` float32 [T + 1, m] and
            possibly ``state`` float32 [T + 1, n]; the arrays may be memory maps.
        metadata: of the data set, with its ``spec``.
        files: further texts by file name.

    Raises:
        OSError: the disk is too small, said before anything is written, or fills up meanwhile; nothing is left.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    first = next(iter(splits.values()))[0]
    count = sum(len(trajectories) for trajectories in splits.values())
    partial = folder.with_name(folder.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        check_space(partial, count * sum(array.nbytes for array in first.values()))
        stored = {}
        for name, trajectories in splits.items():
            frames = len(first["action"])
            split = TensorDict({}, batch_size=[len(trajectories), frames]).memmap_(partial / name)
            for key, array in first.items():
                dtype = torch.uint8 if array.dtype == np.uint8 else torch.float32
                make_map(partial / name, split, key, (len(trajectories), *array.shape), dtype)
            for place, trajectory in enumerate(trajectories):
                for key, array in trajectory.items():
                    split[key][place] = torch.from_numpy(np.array(array))
            stored[name] = split
        write_picture(partial / "contact_sheet.png", contact_sheet(stored))
        for name, text in (files or {}).items():
            (partial / name).write_text(text)
        publish(partial, folder, metadata)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
