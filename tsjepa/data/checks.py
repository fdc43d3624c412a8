"""What no training could make sense of, said before it starts."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

LOOKS = 5  # frames of each trajectory that are compared
MOVED = 0.02  # change of a pose, in metres or radians, that shows in any camera


def check_split(split: TensorDictBase, name: str) -> None:
    """Checks one split, [episodes, T + 1] with ``pixels`` and ``action``, and what else of its keys is there.

    Raises:
        ValueError: a number is not finite, or a trajectory's frames do not change although its scene does.
    """
    for key in ("state", "action", "expert_action", "reference"):
        if key not in split.keys(include_nested=False):
            continue
        bad = (~split[key].isfinite()).flatten(1).any(1).nonzero()
        if len(bad):
            raise ValueError(
                f"The split {name} is of no use: in trajectory {int(bad[0])} of its {len(split)} {key} is not finite; "
                "collect or import the data set anew."
            )
    if "scene" not in split.keys(include_nested=False):
        return
    slots = torch.linspace(0, split.shape[1] - 1, LOOKS).long()
    scene = split["scene"][:, slots]
    moved = (scene - scene[:, :1]).abs().amax((1, 2)) > MOVED
    for episode in moved.nonzero()[:, 0].tolist():
        frames = split["pixels"][episode][slots]
        if (frames == frames[:1]).all():
            raise ValueError(
                f"The split {name} is of no use: the frames of its trajectory {episode} are all the same although the "
                "plant moves; run `tsjepa doctor` to see whether the camera works, then collect the data set anew."
            )
