"""Linear-quadratic regulators: the gain by Riccati's equation, and the law with clipped errors as a module."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


def lqr_gain(
    a: Tensor, b: Tensor, state_weights: Sequence[float] | Tensor, action_weights: Sequence[float] | float
) -> Tensor:
    """Gain of the infinite-horizon linear-quadratic regulator of s[k+1] = A s[k] + B u[k].

    Args:
        a, b, state_weights, action_weights: as of :func:`lqr_value`.

    Returns:
        K [m, n] in float64, for u = -K s.
    """
    weights = torch.as_tensor(action_weights, dtype=torch.float64).expand(b.shape[1])
    value = lqr_value(a, b, state_weights, action_weights)
    return torch.linalg.solve(torch.diag(weights) + b.T @ value @ b, b.T @ value @ a)


def lqr_value(
    a: Tensor, b: Tensor, state_weights: Sequence[float] | Tensor, action_weights: Sequence[float] | float
) -> Tensor:
    """Cost P of the state under that regulator: s^T P s is what is still to come.

    Solves the discrete Riccati equation by the structure-preserving doubling algorithm (Chu, Fan, Lin and Wang,
    International Journal of Control 77(8), 2004), which converges quadratically.

    Args:
        a, b: A [n, n] and B [n, m], float64.
        state_weights: the diagonal of Q [n], or Q [n, n].
        action_weights: the diagonal of R [m], or one number for all.

    Returns:
        P [n, n] in float64, symmetric.
    """
    size = len(a)
    weights = torch.as_tensor(action_weights, dtype=torch.float64).expand(b.shape[1])
    transition, control = a, b @ torch.diag(1 / weights) @ b.T
    cost = torch.as_tensor(state_weights, dtype=torch.float64)
    cost = torch.diag(cost) if cost.ndim == 1 else cost
    identity = torch.eye(size, dtype=torch.float64)
    for _ in range(60):
        solved = torch.linalg.solve(identity + control @ cost, torch.cat([transition, control], dim=1))
        left, middle = solved[:, :size], solved[:, size:]
        update = transition.T @ cost @ left
        control = control + transition @ middle @ transition.T
        cost = cost + (update + update.T) / 2
        transition = transition @ left
        if update.abs().max() <= 1e-13 * cost.abs().max():
            break
    return cost


class ClippedLQR(nn.Module):
    """Linear-quadratic regulator whose position error is clipped, so that a far set-point cannot topple the machine.

    Args:
        gain: K [m, n], for u = -K (clip(s_0 - reference), s_1, ...); the first r states are those with set-points.
        position_clip: largest error of the first state that the law reacts to, in its unit.
        action_low, action_high: range of the command [m], in its unit.
    """

    def __init__(
        self, gain: Tensor, position_clip: float, action_low: Sequence[float], action_high: Sequence[float]
    ) -> None:
        super().__init__()
        gain = torch.as_tensor(gain, dtype=torch.float64)
        self.register_buffer("gain", gain)
        self.register_buffer("position_clip", torch.tensor(float(position_clip)))
        self.action_low, self.action_high = tuple(action_low), tuple(action_high)
        self.register_buffer("low", torch.tensor(self.action_low, dtype=torch.float64), persistent=False)
        self.register_buffer("high", torch.tensor(self.action_high, dtype=torch.float64), persistent=False)

    def forward(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        """The command.

        Args:
            state: [..., n], float32 or float64.
            reference: set-points [..., r] of the first r states, which broadcast against the state; None for 0.

        Returns:
            Command [..., m] within the range, of the state's dtype and device.

        Raises:
            ValueError: the last dimension is not n, or a number is not finite.
        """
        command = self.unsaturated(state, reference)
        return command.clamp(self.low.to(command), self.high.to(command))

    def unsaturated(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        """What the command [..., m] would be if the actuator had no limits; arguments and errors as of the command."""
        error = self.error(state, reference)
        clip = self.position_clip.to(error)
        features = torch.cat([error[..., :1].clamp(-clip, clip), error[..., 1:]], dim=-1)
        return -(features.unsqueeze(-2) * self.gain.to(features)).sum(-1)

    def error(self, state: Tensor, reference: Tensor | None) -> Tensor:
        """States [..., n] with the set-points taken away, checked."""
        size = self.gain.shape[1]
        if state.ndim == 0 or state.shape[-1] != size:
            raise ValueError(f"state has shape {tuple(state.shape)}; its last dimension must be {size}.")
        if not state.is_floating_point():
            raise ValueError(f"state has dtype {state.dtype}; convert it to float32 or float64.")
        if reference is not None:
            tracked = reference.shape[-1]
            error = state[..., :tracked] - reference.to(state)
            state = torch.cat([error, state[..., tracked:].expand(*error.shape[:-1], -1)], dim=-1)
        # a graph that is being exported has no values to check
        if not torch.compiler.is_exporting() and not state.isfinite().all():
            raise ValueError(
                "state or reference holds NaN or infinity; the plant has diverged or an observation is missing."
            )
        return state
