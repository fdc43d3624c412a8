"""Large-scale propagation of 3GPP TR 38.901, indoor factory (InF): path loss, shadowing, line of sight."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Law:
    """One row of Table 7.4.1-1: ``intercept + slope lg(d3D / m) + frequency_slope lg(f / GHz)``, in dB."""

    intercept_db: float
    slope_db: float
    frequency_slope_db: float
    shadowing_std_db: float

    def __call__(self, distance_3d_m: Tensor, carrier_ghz: float) -> Tensor:
        return (
            self.intercept_db
            + self.slope_db * torch.log10(distance_3d_m)
            + self.frequency_slope_db * math.log10(carrier_ghz)
        )


@dataclass(frozen=True)
class Scenario:
    """One InF scenario: its NLoS laws (the loss is the largest of them and LoS), and if the BS tops the clutter."""

    nlos_laws: tuple[Law, ...]
    high_base_station: bool

    @property
    def nlos_shadowing_std_db(self) -> float:
        return self.nlos_laws[-1].shadowing_std_db


LOS = Law(31.84, 21.50, 19.0, shadowing_std_db=4.3)
_SL = Law(33.0, 25.5, 20.0, shadowing_std_db=5.7)
_DL = Law(18.6, 35.7, 20.0, shadowing_std_db=7.2)
_SH = Law(32.4, 23.0, 20.0, shadowing_std_db=5.9)
_DH = Law(33.63, 21.9, 20.0, shadowing_std_db=4.0)

SCENARIOS = {
    "SL": Scenario((_SL,), high_base_station=False),
    "DL": Scenario((_SL, _DL), high_base_station=False),
    "SH": Scenario((_SH,), high_base_station=True),
    "DH": Scenario((_DH,), high_base_station=True),
}


def get_scenario(name: str) -> Scenario:
    """The InF scenario called ``name``; ``ValueError`` names the known ones."""
    if name not in SCENARIOS:
        raise ValueError(f"unknown scenario {name!r}: choose one of {', '.join(SCENARIOS)} (InF of TR 38.901)")
    return SCENARIOS[name]


def path_loss_db(scenario: str, distance_3d_m: Tensor | float, carrier_ghz: float, los: Tensor | bool) -> Tensor:
    """Path loss without shadowing, TR 38.901 Table 7.4.1-1.

    Args:
        scenario: "SL", "DL", "SH" or "DH" (sparse or dense clutter, low or high base station).
        distance_3d_m: distance between the antennas, any shape, 1 to 600 m.
        carrier_ghz: carrier frequency, 0.5 to 100 GHz.
        los: whether the link is in line of sight, bool, broadcast against the distance.

    Returns:
        dB, float64, on the distance's device.

    Raises:
        ValueError: unknown scenario, or a distance or carrier outside the model's validity.
    """
    rows = get_scenario(scenario)
    distance = torch.as_tensor(distance_3d_m, dtype=torch.float64)
    if not bool(((distance >= 1.0) & (distance <= 600.0)).all()):
        raise ValueError(
            f"3D distance {_outside(distance, 1.0, 600.0):g} m is outside the 1 to 600 m where TR 38.901 InF is valid"
        )
    if not 0.5 <= carrier_ghz <= 100.0:
        raise ValueError(f"carrier {carrier_ghz:g} GHz is outside the 0.5 to 100 GHz for which TR 38.901 is valid")
    los_loss = LOS(distance, carrier_ghz)
    nlos_loss = los_loss
    for law in rows.nlos_laws:
        nlos_loss = torch.maximum(nlos_loss, law(distance, carrier_ghz))
    return torch.where(torch.as_tensor(los, device=distance.device), los_loss, nlos_loss)


def shadowing_std_db(scenario: str, los: Tensor | bool) -> Tensor:
    """Standard deviation of the log-normal shadowing, TR 38.901 Table 7.4.1-1, dB, float64, shape of ``los``."""
    nlos = get_scenario(scenario).nlos_shadowing_std_db
    los = torch.as_tensor(los)
    return torch.full(los.shape, nlos, dtype=torch.float64, device=los.device).masked_fill(los, LOS.shadowing_std_db)


def los_probability(
    scenario: str,
    distance_2d_m: Tensor | float,
    clutter_density: float = 0.6,
    clutter_size_m: float = 2.0,
    clutter_height_m: float = 3.0,
    base_station_height_m: float = 10.0,
    device_height_m: float = 1.5,
    formula: str = "38.901",
) -> Tensor:
    """Probability of line of sight, TR 38.901 Table 7.4.2-1: ``exp(-d2D / k)``.

    Args:
        scenario: "SL", "DL", "SH" or "DH".
        distance_2d_m: horizontal distance, any shape, at least 0.
        clutter_density: share of the floor under clutter, in (0, 1).
        clutter_size_m, clutter_height_m: size and height of a clutter element.
        base_station_height_m, device_height_m: antenna heights; only SH, DH and the printed form use the three heights.
        formula: "38.901", or "paper_literal" for the printed form, whose height ratio multiplies the exponent
            instead of stretching k.

    Returns:
        Probability, float64.

    Raises:
        ValueError: a parameter outside its range, or where heights are used not device < clutter < base station height.
    """
    high = get_scenario(scenario).high_base_station
    distance = torch.as_tensor(distance_2d_m, dtype=torch.float64)
    if not bool((distance >= 0.0).all()):
        raise ValueError("a 2D distance is negative or not a number: give metres >= 0")
    if not 0.0 < clutter_density < 1.0:
        raise ValueError(f"clutter density {clutter_density:g} must lie strictly between 0 and 1")
    if not clutter_size_m > 0.0:
        raise ValueError(f"clutter size {clutter_size_m:g} m must be positive")
    if formula not in ("38.901", "paper_literal"):
        raise ValueError(f"unknown LoS formula {formula!r}: choose '38.901' or 'paper_literal'")
    uses_heights = high or formula == "paper_literal"
    if uses_heights and not device_height_m < clutter_height_m < base_station_height_m:
        raise ValueError(
            f"InF-{scenario} by the formula {formula} needs device height < clutter height < base station height, "
            f"got {device_height_m:g}, {clutter_height_m:g}, {base_station_height_m:g} m"
        )
    reach = -clutter_size_m / math.log1p(-clutter_density)
    if uses_heights:
        ratio = (base_station_height_m - device_height_m) / (clutter_height_m - device_height_m)
        reach = reach / ratio if formula == "paper_literal" else reach * ratio
    return torch.exp(-distance / reach)


def _outside(values: Tensor, low: float, high: float) -> float:
    """The first value outside [low, high] (or not a number), for an error message."""
    return values[~((values >= low) & (values <= high))].flatten()[0].item()
