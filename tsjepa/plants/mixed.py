"""A fleet of machines that are not alike: several kinds of one plant behind one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.plants.plant import Plant


class Mixed(Plant):
    """Kinds of one plant that differ in their physics, such as the length of a pole, dealt to the devices in turn.

    Device i is of the kind ``plants[i % len(plants)]``, in a fleet of any size. Each kind has a model of its own, which
    steps the devices of this kind; physics and scene carry the number of the kind as their last entry. Score, failure
    and set-points are those that all kinds share, and so are names, units and ranges.

    What belongs to a kind but is asked for states alone, :meth:`experts`, tells the devices apart by their place on the
    last batch dimension.

    Args:
        plants: of one class and one spec.

    Raises:
        ValueError: fewer than two, or plants that cannot be mixed.
    """

    def __init__(self, plants: list[Plant]) -> None:
        if len(plants) < 2:
            raise ValueError(f"A mixed fleet needs at least 2 kinds of plant, got {len(plants)}.")
        first = plants[0]
        for other in plants[1:]:
            if type(other) is not type(first) or other.spec != first.spec:
                raise ValueError(
                    f"Plants of a mixed fleet are of one class and one spec; {type(other).__name__} is not like "
                    f"{type(first).__name__}, or has other names, units, ranges or slots."
                )
        self.plants, self.spec, self.normaliser = list(plants), first.spec, first.normaliser

    def start(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """Every kind's own start, and the kind."""
        kind = device % len(self.plants)
        physics = self._by_kind(kind, lambda plant, rows: plant.start(seed, device[rows], episode[rows]))
        return np.column_stack((physics, kind))

    def advance(self, physics, action, seed, device, episode, slot) -> np.ndarray:
        """One slot of every kind's own model."""
        episode, slot = (np.broadcast_to(number, len(physics)) for number in (episode, slot))

        def step(plant: Plant, rows: np.ndarray) -> np.ndarray:
            return plant.advance(physics[rows, :-1], action[rows], seed, device[rows], episode[rows], slot[rows])

        return np.column_stack((self._by_kind(physics[:, -1], step), physics[:, -1]))

    def state(self, physics: np.ndarray) -> np.ndarray:
        """The kinds' own."""
        return self._by_kind(physics[:, -1], lambda plant, rows: plant.state(physics[rows, :-1]))

    def scene(self, physics, seed, device, episode) -> np.ndarray:
        """The kinds' own, and the kind."""
        kind = physics[:, -1]
        scenes = self._by_kind(
            kind, lambda plant, rows: plant.scene(physics[rows, :-1], seed, device[rows], episode[rows])
        )
        return np.column_stack((scenes, kind)).astype(np.float32)

    def render(self, scene: np.ndarray) -> np.ndarray:
        """Pictures of every kind's own model."""
        return self._by_kind(scene[:, -1], lambda plant, rows: plant.render(scene[rows, :-1]))

    def camera(self) -> dict:
        """Of the first kind, whose view all have."""
        return self.plants[0].camera()

    def references(self, seed, device, episode, slot) -> np.ndarray | None:
        """Of the first kind."""
        return self.plants[0].references(seed, device, episode, slot)

    def score(self, state, reference=None):
        """Of the first kind, as of all."""
        return self.plants[0].score(state, reference)

    def failed(self, state):
        """Of the first kind, as of all."""
        return self.plants[0].failed(state)

    def experts(self) -> dict[str, nn.Module]:
        """Every kind's expert of a name, for the devices of this kind."""
        experts = [plant.experts() for plant in self.plants]
        return {name: ByDevice([of_kind[name] for of_kind in experts]) for name in experts[0]}

    def goals(self, episodes: int, slots: int, generator: torch.Generator) -> Tensor | None:
        """Of the first kind."""
        return self.plants[0].goals(episodes, slots, generator)

    def linear(self) -> tuple[Tensor, Tensor] | None:
        """A [kinds, n, n] and B [kinds, n, m]."""
        return self._stacked([plant.linear() for plant in self.plants])

    def error_cost(self) -> tuple[Tensor, Tensor] | None:
        """P and W [kinds, n, n]."""
        return self._stacked([plant.error_cost() for plant in self.plants])

    @staticmethod
    def _stacked(pairs: list[tuple[Tensor, Tensor] | None]) -> tuple[Tensor, Tensor] | None:
        return None if None in pairs else tuple(torch.stack(part) for part in zip(*pairs, strict=True))

    def _by_kind(self, kind: np.ndarray, values: Callable[[Plant, np.ndarray], np.ndarray]) -> np.ndarray:
        """Rows [N, ...] that each kind computes for its own."""
        result: Any = None
        for number, plant in enumerate(self.plants):
            rows = np.flatnonzero(kind == number)
            if len(rows):
                own = values(plant, rows)
                result = np.empty((len(kind), *own.shape[1:]), own.dtype) if result is None else result
                result[rows] = own
        return result


class ByDevice(nn.Module):
    """A law a kind of plant; device i, counted on the last batch dimension, is under ``laws[i % len(laws)]``.

    Args:
        laws: from states [..., n] and set-points [..., r] (or None) to commands [..., m].
    """

    def __init__(self, laws: list[nn.Module]) -> None:
        super().__init__()
        self.laws = nn.ModuleList(laws)

    def forward(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        """Commands [..., I, m] for states [..., I, n]."""
        return self._dealt(self.laws, state, reference)

    def unsaturated(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        """The same without the actuator's limits, of laws that can say it."""
        return self._dealt([getattr(law, "unsaturated", law) for law in self.laws], state, reference)

    @staticmethod
    def _dealt(laws, state: Tensor, reference: Tensor | None) -> Tensor:
        kinds, command = len(laws), None
        for kind, law in enumerate(laws[: state.shape[-2]]):
            known = reference if reference is None else reference[..., kind::kinds, :]
            own = law(state[..., kind::kinds, :], known)
            command = own.new_empty((*state.shape[:-1], own.shape[-1])) if command is None else command
            command[..., kind::kinds, :] = own
        return command
