"""The plant: the one place that knows a machine. Everything that changes is in the arguments."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.support.spec import PlantSpec


class Plant(ABC):
    """A kind of machine, of which N independent ones are computed at once.

    No method keeps anything between calls: what a row gives depends on that row's arguments alone, so a fleet may be
    split, branched and resumed anywhere. ``seed``, ``device``, ``episode`` and ``slot`` key the random numbers.
    """

    spec: PlantSpec
    normaliser: str = "expert"
    """Name of the expert whose score with perfect feedback is 1 in every normalised score."""

    @abstractmethod
    def start(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """Physics [N, p] float64 at the start of an episode."""

    @abstractmethod
    def advance(
        self,
        physics: np.ndarray,
        action: np.ndarray,
        seed: int,
        device: np.ndarray,
        episode: np.ndarray,
        slot: np.ndarray,
    ) -> np.ndarray:
        """Physics [N, p] one slot later, under commands [N, m] that are held, process noise included.

        Raises:
            ValueError: a command outside the actuator's range, or that is not a number.
        """

    @abstractmethod
    def state(self, physics: np.ndarray) -> np.ndarray:
        """State [N, n] float64, with angles as they are scored."""

    @abstractmethod
    def scene(self, physics: np.ndarray, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """All that a camera needs, [N, s] float32: poses and colours."""

    @abstractmethod
    def render(self, scene: np.ndarray) -> np.ndarray:
        """Pictures uint8 [N, H, W, 3] of scenes [N, s]."""

    def camera(self) -> dict:
        """How pictures are made, for the record: view, samples, GL renderer."""
        return {}

    def references(self, seed: int, device: np.ndarray, episode: np.ndarray, slot: np.ndarray) -> np.ndarray | None:
        """Set-points [N, r] of a slot, known at the controller; None where the plant has none."""
        return None

    @abstractmethod
    def score(self, state, reference=None):
        """How well states [..., n] do, [...] in 0..1; of NumPy arrays and of tensors alike."""

    def failed(self, state):
        """Whether states [..., n] are beyond recovery, [...] bool; of NumPy arrays and of tensors alike."""
        return abs(state[..., 0]) > np.inf

    @abstractmethod
    def experts(self) -> dict[str, nn.Module]:
        """Policies from (state [..., n], reference [..., r] or None) to commands [..., m]; the first is imitated."""

    def goals(self, episodes: int, slots: int, generator: torch.Generator) -> Tensor | None:
        """Set-points [episodes, slots, r] that make recorded trajectories cover the states; None for none."""
        return None

    def linear(self) -> tuple[Tensor, Tensor] | None:
        """A [n, n] and B [n, m] in float64 of the state one slot later near the goal; None where there are none."""
        return None

    def error_cost(self) -> tuple[Tensor, Tensor] | None:
        """P [n, n], what a squared error of the state costs, and W [n, n], covariance of a slot's noise; float64.

        Both are near the goal, P the solution of a Riccati equation; None where there are none.
        """
        return None


def expert_of(plant: Plant, name: str | None = None) -> nn.Module:
    """The plant's expert of this name, or the first, which is imitated.

    Raises:
        ValueError: it has none of that name.
    """
    experts = plant.experts()
    name = next(iter(experts), plant.normaliser) if name is None else name
    if name not in experts:
        raise ValueError(
            f"The plant {type(plant).__name__} has no expert {name!r}; there are {list(experts)}: call one so in "
            "experts(), or set the plant's attribute normaliser to the name of one."
        )
    return experts[name]


def check_plant(plant: Plant) -> None:
    """Refuses a plant whose methods do not give what :class:`Plant` says, before a fleet of them is run.

    Raises:
        ValueError: it has no expert of its normaliser's name, or a method gives another shape than its spec's.
    """
    expert_of(plant, plant.normaliser)
    spec, devices, episodes = plant.spec, np.arange(2), np.zeros(2, np.int64)
    physics = plant.start(0, devices, episodes)
    state, reference = plant.state(physics), plant.references(0, devices, episodes, episodes)
    given: dict[str, tuple[Any, tuple[int, ...]]] = {"state": (state, (2, spec.state_dim))}
    if reference is not None:
        given["references"] = reference, (2, spec.reference_dim)
        reference = torch.as_tensor(reference, dtype=torch.float32)
    if np.shape(state) == (2, spec.state_dim):
        known = torch.as_tensor(state, dtype=torch.float32)
        given["experts"] = expert_of(plant)(known, reference), (2, spec.action_dim)
        given |= {"score": (plant.score(known, reference), (2,)), "failed": (plant.failed(known), (2,))}
    for method, (value, wanted) in given.items():
        if np.shape(value) != wanted:
            raise ValueError(
                f"For 2 devices {method} of the plant {type(plant).__name__} gives an array of shape "
                f"{list(np.shape(value))}; it has to be {list(wanted)}, as its spec says."
            )
