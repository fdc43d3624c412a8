"""Optimal control of the cart-pole from its true state: the policy that the paper's controller imitates."""

from __future__ import annotations

import math

import torch
from torch import nn

CART_MASS = 1.0
POLE_MASS = 0.1
POLE_CENTRE = 0.5  # metres from the hinge to the pole's centre of mass
POLE_INERTIA = (
    0.00942459  # kg m^2 about its centre: a solid capsule of 1 m between the centres of its caps, radius 0.045 m
)
SLIDER_DAMPING = 5e-4
HINGE_DAMPING = 2e-6
GRAVITY = 9.81
MAX_FORCE = 20.0  # newtons


def linearised_plant(sampling_interval: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Linearise dm-control's cart-pole about the upright pole and discretise it with the force held over a slot.

    Args:
        sampling_interval: length of a slot in seconds.

    Returns:
        A [4, 4] and B [4, 1] in float64 of s[k+1] = A s[k] + B u[k], state (x, theta, x_dot, theta_dot), u in newtons.

    Raises:
        ValueError: if the interval is not a positive finite number.
    """
    if not (math.isfinite(sampling_interval) and sampling_interval > 0):
        raise ValueError(f"sampling_interval is {sampling_interval}; give a positive number of seconds, such as 0.02.")
    moment = POLE_MASS * POLE_CENTRE
    mass = torch.tensor(
        [[CART_MASS + POLE_MASS, moment], [moment, POLE_INERTIA + moment * POLE_CENTRE]], dtype=torch.float64
    )
    inverse = torch.linalg.inv(mass)
    continuous = torch.zeros(5, 5, dtype=torch.float64)
    continuous[:2, 2:4] = torch.eye(2)
    continuous[2:4, 1] = inverse[:, 1] * moment * GRAVITY
    continuous[2:4, 2:4] = -inverse @ torch.diag(torch.tensor([SLIDER_DAMPING, HINGE_DAMPING], dtype=torch.float64))
    continuous[2:4, 4] = inverse[:, 0]
    discrete = torch.linalg.matrix_exp(continuous * sampling_interval)
    return discrete[:4, :4], discrete[:4, 4:]


def lqr_gain(sampling_interval: float, state_weights: tuple[float, ...], force_weight: float) -> torch.Tensor:
    """Gain of the infinite-horizon linear-quadratic regulator of the linearised plant.

    Solves the discrete Riccati equation by the structure-preserving doubling algorithm (Chu, Fan, Lin and Wang,
    International Journal of Control 77(8), 2004), which converges quadratically.

    Args:
        sampling_interval: length of a slot in seconds.
        state_weights: the diagonal of Q, in the order x, theta, x_dot, theta_dot.
        force_weight: R, per newton squared.

    Returns:
        K [4] in float64, for u = -K s.
    """
    a, b = linearised_plant(sampling_interval)
    transition, control = a, b @ b.T / force_weight
    cost = torch.diag(torch.tensor(state_weights, dtype=torch.float64))
    identity = torch.eye(4, dtype=torch.float64)
    for _ in range(60):
        solved = torch.linalg.solve(identity + control @ cost, torch.cat([transition, control], dim=1))
        left, middle = solved[:, :4], solved[:, 4:]
        update = transition.T @ cost @ left
        control = control + transition @ middle @ transition.T
        cost = cost + (update + update.T) / 2
        transition = transition @ left
        if update.abs().max() <= 1e-13 * cost.abs().max():
            break
    return torch.linalg.solve(force_weight + b.T @ cost @ b, b.T @ cost @ a)[0]


class ClippedLQR(nn.Module):
    """Linear-quadratic regulator whose position error is clipped, so that a far set point cannot topple the pole.

    A policy like the learned ones: ``TensorDictModule(Expert(), in_keys=["state"], out_keys=["action"])`` drives an
    environment.

    Args:
        gain: K [4], for u = -K (clip(x - x_d), theta, x_dot, theta_dot).
        position_clip: largest position error that the law reacts to, in metres.
    """

    def __init__(self, gain: torch.Tensor, position_clip: float) -> None:
        super().__init__()
        self.register_buffer("gain", gain)
        self.position_clip = position_clip

    def forward(self, state: torch.Tensor, set_point: float | torch.Tensor = 0.0) -> torch.Tensor:
        """Compute the command.

        Args:
            state: [..., 4], (x m, theta rad, x_dot m/s, theta_dot rad/s), theta = 0 upright, float32 or float64.
            set_point: wanted cart position x_d in metres, a number or a tensor that broadcasts against state[..., 0].

        Returns:
            Force in newtons [..., 1], within +-20 N, of the state's dtype and device.

        Raises:
            ValueError: if the last dimension is not 4 or a state or set point is not finite.
        """
        state, error = checked_error(state, set_point)
        features = torch.cat([error.clamp(-self.position_clip, self.position_clip), state[..., 1:]], dim=-1)
        force = -(features * self.gain.to(state)).sum(-1, keepdim=True)
        return force.clamp(-MAX_FORCE, MAX_FORCE)


def checked_error(state: torch.Tensor, set_point: float | torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Check a policy's input and return (state [..., 4], position error x - x_d [..., 1]), broadcast together."""
    if state.ndim == 0 or state.shape[-1] != 4:
        raise ValueError(
            f"state has shape {tuple(state.shape)}; its last dimension must be 4: x, theta, x_dot, theta_dot."
        )
    if not state.is_floating_point():
        raise ValueError(f"state has dtype {state.dtype}; convert it to float32 or float64.")
    error = (state[..., 0] - torch.as_tensor(set_point).to(state)).unsqueeze(-1)
    state = state.expand(*error.shape[:-1], 4)
    if not (state.isfinite().all() and error.isfinite().all()):
        raise ValueError(
            "state or set_point holds NaN or infinity; the plant has diverged or an observation is missing."
        )
    return state, error


def reference_lqr(sampling_interval: float = 0.02) -> ClippedLQR:
    """The linear-quadratic regulator with Q = diag(10, 10, 0.1, 0.1), R = 1e-3, position error clipped at 0.5 m."""
    return ClippedLQR(lqr_gain(sampling_interval, (10.0, 10.0, 0.1, 0.1), 1e-3), position_clip=0.5)


class Expert(ClippedLQR):
    """The optimal policy of the paper, with perfect feedback; the tsjepa controller is trained to imitate it.

    The paper names a non-linear optimal policy without giving it. This one is the linear-quadratic regulator with
    Q = diag(1.6, 1, 0.005, 0.005), R = 1e-3, solved for the sampling interval, position error clipped at 0.65 m and
    force at 20 N. The weights come from a search (evolution strategy, then a grid) over diagonal Q, clips, other
    saturations and blends of two gains, scored with and without measurement and process noise. It reaches the box
    slightly sooner than `reference_lqr` at slightly less cost. Its command answers errors in the state about half as
    much, because velocity is hardly penalised: with noise of 8 mm, 5 mrad, 0.06 m/s and 0.08 rad/s the command errs by
    3.0 N instead of 5.9 N at 20 ms.

    Args:
        sampling_interval: length of a slot in seconds, over which a command is held.
    """

    def __init__(self, sampling_interval: float = 0.02) -> None:
        super().__init__(lqr_gain(sampling_interval, (1.6, 1.0, 0.005, 0.005), 1e-3), position_clip=0.65)
