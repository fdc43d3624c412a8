"""Runs a plant's expert on its true state, without the chain."""

from __future__ import annotations

import numpy as np
import torch

SEED = 1_000_000  # of starts that no other test uses


def run(plant, slots: int, count: int = 60, hold: int = 1, expert: str | None = None, seed: int = SEED):
    """Mean score over slots and machines (nothing counts after a failure), how many have failed, and the last states.

    Args:
        plant: the kind of machine.
        slots, count: how many.
        hold: the command is new in every ``hold``-th slot and held between.
        expert: its name; the first by default.
        seed: of starts, noise and set-points.
    """
    law = plant.experts()[expert] if expert else next(iter(plant.experts().values()))
    device, episode = np.arange(count), np.zeros(count, np.int64)
    physics = plant.start(seed, device, episode)
    failed, score = np.asarray(plant.failed(plant.state(physics))), 0.0
    for index in range(slots):
        slot = np.full(count, index)
        reference = plant.references(seed, device, episode, slot)
        if index % hold == 0:
            known = None if reference is None else torch.from_numpy(reference)
            action = law(torch.from_numpy(plant.state(physics)), known).numpy()
        physics = plant.advance(physics, action, seed, device, episode, slot)
        state = plant.state(physics)
        failed = failed | plant.failed(state)
        score += float((np.asarray(plant.score(state, reference), float) * ~failed).mean())
    return score / slots, int(failed.sum()), state
