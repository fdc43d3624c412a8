"""Where the devices stand, and the large-scale channel that follows from it."""

from dataclasses import dataclass

import torch
from torch import Tensor

from tsjepa.radio.path_loss import get_scenario, los_probability, path_loss_db, shadowing_std_db
from tsjepa.radio.streams import normal, uniform


@dataclass(frozen=True)
class Deployment:
    """A factory hall with the base station above its centre (the paper's table of system parameters).

    Attributes:
        scenario: TR 38.901 InF scenario, "SL", "DL", "SH" or "DH".
        carrier_ghz: carrier frequency.
        distance_2d_m: horizontal distance of every device, or None to draw positions uniformly in the hall.
        hall_m: length and width of the hall.
        base_station_height_m, device_height_m: antenna heights.
        clutter_density, clutter_size_m, clutter_height_m: clutter of the LoS probability.
        los: "random" draws the LoS state per device and episode, "los" and "nlos" fix it.
        los_formula: "38.901" or "paper_literal".
        shadowing: whether log-normal shadowing is drawn per device and episode.
    """

    scenario: str = "DH"
    carrier_ghz: float = 3.75
    distance_2d_m: float | None = None
    hall_m: tuple[float, float] = (300.0, 150.0)
    base_station_height_m: float = 10.0
    device_height_m: float = 1.5
    clutter_density: float = 0.6
    clutter_size_m: float = 2.0
    clutter_height_m: float = 3.0
    los: str = "random"
    los_formula: str = "38.901"
    shadowing: bool = True

    def __post_init__(self):
        get_scenario(self.scenario)
        if self.los not in ("random", "los", "nlos"):
            raise ValueError(f"unknown LoS rule {self.los!r}: choose 'random', 'los' or 'nlos'")


PAPER_LITERAL = Deployment(distance_2d_m=50.0, los="nlos", shadowing=False)
"""The paper as printed: every device at 50 m, always NLoS, no shadowing."""


def distances_2d(deployment: Deployment, seed: int, device: Tensor) -> Tensor:
    """Horizontal distance of each device to the base station, m, float64; a device keeps its place for good."""
    if deployment.distance_2d_m is not None:
        return torch.full(device.shape, deployment.distance_2d_m, dtype=torch.float64, device=device.device)
    length, width = deployment.hall_m
    x = length * (uniform(seed, "position", device, torch.zeros_like(device)) - 0.5)
    y = width * (uniform(seed, "position", device, torch.ones_like(device)) - 0.5)
    return torch.hypot(x, y)


def large_scale(deployment: Deployment, seed: int, device: Tensor, episode: Tensor) -> tuple[Tensor, Tensor]:
    """Path loss with shadowing (dB, float64) and LoS state (bool) of each device in an episode.

    Args:
        deployment: geometry and scenario.
        seed: seed of the position, LoS and shadowing streams.
        device, episode: int64 counters of one shape.
    """
    distance_2d = distances_2d(deployment, seed, device)
    if deployment.los == "random":
        probability = los_probability(
            deployment.scenario,
            distance_2d,
            deployment.clutter_density,
            deployment.clutter_size_m,
            deployment.clutter_height_m,
            deployment.base_station_height_m,
            deployment.device_height_m,
            deployment.los_formula,
        )
        los = uniform(seed, "los", device, episode) < probability
    else:
        los = torch.full(device.shape, deployment.los == "los", device=device.device)
    height = deployment.base_station_height_m - deployment.device_height_m
    distance_3d = torch.sqrt(distance_2d**2 + height**2)
    loss = path_loss_db(deployment.scenario, distance_3d, deployment.carrier_ghz, los)
    if deployment.shadowing:
        loss = loss + shadowing_std_db(deployment.scenario, los) * normal(seed, "shadowing", device, episode)
    return loss, los
