"""A run with what its cameras saw and its controller believed, for films and recordings."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from tsjepa.envs.payload import sends_frames
from tsjepa.evaluation.metrics import Run
from tsjepa.evaluation.rollouts import Loop, run
from tsjepa.models import Controller


@dataclass(frozen=True)
class Shown:
    """A run, and what can be drawn of it.

    Args:
        run: what happened.
        scenes: [T, I, s], what the cameras saw as each slot began.
        beliefs: [T, I, d], the embeddings by which a model acted; None where nobody acts by embeddings.
        references: [T, I, r], set-points; None where the plant has none.
    """

    run: Run
    scenes: Tensor
    beliefs: Tensor | None = None
    references: Tensor | None = None


def shown_run(loop: Loop, seed: int) -> Shown:
    """Runs ``loop`` as :func:`tsjepa.evaluation.rollouts.run` does, and keeps what can be drawn."""
    scenes, beliefs, references = [], [], []

    def watch(slot: int, now: TensorDictBase) -> None:
        scenes.append(now["scene"][:, -1])
        references.append(now.get("reference", None))
        beliefs.append(believed(loop, now, beliefs[-1] if beliefs else None))

    done = run(loop, seed, watch)
    kept = [None if values[0] is None else torch.stack(values) for values in (scenes, beliefs, references)]
    return Shown(done, *kept)


def believed(loop: Loop, now: TensorDictBase, before: Tensor | None) -> Tensor | None:
    """The embeddings [I, d] by which the controller of ``loop`` acts in the slot ``now``.

    Args:
        loop: whose controller it is; one on the state acts by no embedding.
        now: the chain's tensordict.
        before: the embeddings of the slot before.
    """
    if not isinstance(loop.controller, Controller):
        return None
    if "belief" in now:
        return now["belief"]
    if sends_frames(loop.radio.codec) and before is not None:
        return torch.where(now["delivered"].unsqueeze(-1), now["embedding"], before)
    return now["embedding" if sends_frames(loop.radio.codec) else "received"]
