"""The regulator of a machine about a pose in which it can stand, or the sentence that says why there is none."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from tsjepa.plants.lqr import lqr_gain

Step = Callable[[np.ndarray, np.ndarray], np.ndarray]
DIFFERENCE = 1e-6  # m, rad, per second and of the command's unit
DRIFT = 1e-3  # m, rad or per second in one slot, beyond which a pose is no equilibrium
REACHED = 1e-6  # of the largest: a direction that commands move less is one that they do not move
GROWING = 1.0 + 1e-4  # per slot


def jacobians(step: Step, size: int, actions: int) -> tuple[np.ndarray, np.ndarray]:
    """Central differences about 0 of the displacement a slot later: [size, size] and [size, actions].

    Args:
        step: from displacements [N, size] and commands [N, actions] to displacements one slot later [N, size].
        size: of a displacement, positions and rates.
        actions: commands.
    """
    points = DIFFERENCE * np.eye(size + actions)
    points = np.concatenate([points, -points])
    after = step(points[:, :size], points[:, size:])
    jacobian = (after[: size + actions] - after[size + actions :]).T / (2 * DIFFERENCE)
    return jacobian[:, :size], jacobian[:, size:]


def check_equilibrium(later: np.ndarray, names: Sequence[str], stands: bool) -> None:
    """Refuses a pose that the machine leaves by itself.

    Args:
        later: its displacement [size] after one slot at rest.
        names: of the displacement's numbers.
        stands: whether it touches something or hangs on a joint.

    Raises:
        ValueError: saying what to give.
    """
    if not stands:
        raise ValueError(
            "The machine is in the air and falls: give settle, the seconds in which it comes to rest on the ground, or "
            "a pose in which it stands."
        )
    worst = int(np.abs(later).argmax())
    if not np.abs(later[worst]) <= DRIFT:
        raise ValueError(
            f"The pose is no equilibrium: with all commands at 0, {names[worst]} changes by {later[worst]:.2g} in the "
            "first slot; give a pose (or settle) in which the machine stands still."
        )


def reduced(a: np.ndarray, b: np.ndarray, c: np.ndarray, names: Sequence[str]) -> tuple[Tensor, Tensor]:
    """A [n, n] and B [n, m] of the stated coordinates alone.

    Args:
        a, b: of the whole displacement [size].
        c: [n, size], how the stated coordinates follow from it.
        names: of the displacement's numbers.

    Raises:
        ValueError: the stated coordinates do not decide how they go on.
    """
    inside = c @ a @ np.linalg.pinv(c)
    missing = np.abs(c @ a - inside @ c)
    if missing.max() > 1e-3 * max(1.0, np.abs(inside).max()):
        _, column = np.unravel_index(missing.argmax(), missing.shape)
        raise ValueError(
            f"The stated coordinates do not decide how they go on: they depend on {names[column]} too; add it to state."
        )
    return torch.from_numpy(inside), torch.from_numpy(c @ b)


def balancing_gain(
    a: Tensor, b: Tensor, state_weights: Sequence[float], action_weights: Sequence[float], names: Sequence[str]
) -> Tensor:
    """The regulator's gain [m, n] on what commands can move; what they cannot has to be at rest by itself.

    Args:
        a, b: A [n, n] and B [n, m] of one slot, float64.
        state_weights, action_weights: diagonals of Q [n] and R [m].
        names: of the n coordinates.

    Raises:
        ValueError: something that no command moves grows by itself.
    """
    basis = _reachable(a, b)
    if not basis.shape[1]:
        raise ValueError(
            "No command in action moves anything in state: name an actuator or a coordinate that it moves."
        )
    rest = torch.linalg.qr(torch.cat((basis, torch.eye(len(a), dtype=a.dtype)), dim=1)).Q[:, basis.shape[1] :]
    values, vectors = torch.linalg.eig(rest.T @ a @ rest)
    if len(values) and (worst := int(values.abs().argmax())) >= 0 and values[worst].abs() > GROWING:
        mode = (rest.to(vectors) @ vectors[:, worst]).abs()
        raise ValueError(
            f"It cannot be balanced, because it is not controllable: {names[int(mode.argmax())]} grows "
            f"{float(values[worst].abs()):.3g}-fold in a slot, and no command in action moves it; name an actuator "
            "that does."
        )
    weights = basis.T @ torch.diag(torch.as_tensor(state_weights, dtype=a.dtype)) @ basis
    return lqr_gain(basis.T @ a @ basis, basis.T @ b, weights, action_weights) @ basis.T


def _reachable(a: Tensor, b: Tensor) -> Tensor:
    """Orthonormal basis [n, k] of what commands move sooner or later."""
    basis, new = torch.zeros(len(a), 0, dtype=a.dtype), b / b.norm().clamp(min=REACHED)
    while new.shape[1] and basis.shape[1] < len(a):
        new = new - basis @ (basis.T @ new)
        left, sizes, _ = torch.linalg.svd(new, full_matrices=False)
        left = left[:, sizes > REACHED]
        basis, new = torch.cat((basis, left), dim=1), a @ left
    return basis
