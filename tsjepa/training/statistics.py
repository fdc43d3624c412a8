"""Means, standard deviations and the error of commands."""

from __future__ import annotations

from torch import Tensor

from tsjepa.support.spec import PlantSpec


def mean_and_std(values: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation over the first dimension of ``values`` [N, ...].

    What does not vary gets a standard deviation of 1, so that scaling leaves a zero there and not a division by zero.
    """
    std = values.std(0)
    return values.mean(0), std.where(std > 0, 1.0)


def command_nmae(command: Tensor, wanted: Tensor, spec: PlantSpec) -> Tensor:
    """Mean distance of commands [..., m] to the wanted ones over the actuator's range (paper eq. eq5_NMAE)."""
    return ((command - wanted).abs() / command.new_tensor(spec.action_range)).mean()


def squared_command_error(command: Tensor, wanted: Tensor, spec: PlantSpec) -> Tensor:
    """Mean squared error of commands [..., m], in half ranges of the actuator."""
    return ((command - wanted) / (command.new_tensor(spec.action_range) / 2)).square().mean()
