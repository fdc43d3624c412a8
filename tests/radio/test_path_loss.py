"""TR 38.901 InF against the reference numbers of a hand calculation."""

import math

import pytest
import torch

from tsjepa.radio import los_probability, path_loss_db
from tsjepa.radio.path_loss import shadowing_std_db

DISTANCE_3D = math.hypot(50.0, 8.5)


def test_distance():
    assert abs(DISTANCE_3D - 50.717354) < 5e-7


@pytest.mark.parametrize(
    "scenario, los, at_50_m, at_10_m",
    [
        ("DH", True, 79.407461, 64.246594),
        ("SL", False, 87.962118, 69.980625),
        ("DL", False, 90.954716, 69.980625),
        ("SH", False, 83.099227, 66.880625),
        ("DH", False, 82.453555, 67.010625),
    ],
)
def test_path_loss(scenario, los, at_50_m, at_10_m):
    loss = path_loss_db(scenario, torch.tensor([DISTANCE_3D, 10.0], dtype=torch.float64), 3.75, los)
    assert loss.tolist() == pytest.approx([at_50_m, at_10_m], abs=5.1e-7)


def test_los_is_selected_per_element_and_shapes_broadcast():
    distance = torch.full((3, 1), DISTANCE_3D, dtype=torch.float64)
    loss = path_loss_db("SL", distance, 3.75, torch.tensor([True, False]))
    assert loss.shape == (3, 2)
    assert loss[0].tolist() == pytest.approx([79.407461, 87.962118], abs=5.1e-7)


def test_nlos_is_never_below_los():
    distance = torch.linspace(1.0, 600.0, 2000, dtype=torch.float64)
    for scenario in ("SL", "DL", "SH", "DH"):
        for carrier in (0.5, 3.75, 100.0):
            los = path_loss_db(scenario, distance, carrier, True)
            assert (path_loss_db(scenario, distance, carrier, False) >= los).all()


@pytest.mark.parametrize(
    "scenario, clutter, formula, expected, digits",
    [
        ("DH", {}, "38.901", 1.755425e-2, 7),
        ("DH", {}, "paper_literal", 4.218572e-57, 7),
        ("SH", dict(clutter_density=0.2, clutter_size_m=10.0, clutter_height_m=2.0), "38.901", 0.936477, 6),
        ("DH", dict(clutter_density=0.6, clutter_size_m=2.0, clutter_height_m=6.0), "38.901", 5.409373e-6, 7),
    ],
)
def test_los_probability(scenario, clutter, formula, expected, digits):
    probability = los_probability(scenario, 50.0, formula=formula, **clutter)
    assert f"{probability.item():.{digits - 1}e}" == f"{expected:.{digits - 1}e}"


def test_los_probability_of_low_base_stations_ignores_heights():
    expected = math.exp(50.0 * math.log(0.4) / 2.0)
    assert los_probability("DL", 50.0, clutter_height_m=0.1).item() == pytest.approx(expected)
    assert -50.0 / math.log(los_probability("DH", 50.0).item()) == pytest.approx(12.368709, abs=5e-7)


def test_shadowing():
    nlos = {s: shadowing_std_db(s, False).item() for s in ("SL", "DL", "SH", "DH")}
    assert nlos == {"SL": 5.7, "DL": 7.2, "SH": 5.9, "DH": 4.0}
    assert shadowing_std_db("DH", torch.tensor([True, False])).tolist() == [4.3, 4.0]


@pytest.mark.parametrize("distance", [0.999, 600.001, float("nan"), -5.0])
def test_distance_outside_validity_is_rejected(distance):
    with pytest.raises(ValueError, match="3D distance"):
        path_loss_db("DH", torch.tensor([50.0, distance]), 3.75, True)


@pytest.mark.parametrize("carrier", [0.49, 100.1, float("nan")])
def test_carrier_outside_validity_is_rejected(carrier):
    with pytest.raises(ValueError, match="carrier"):
        path_loss_db("DH", 50.0, carrier, True)


def test_other_bad_input_is_rejected():
    with pytest.raises(ValueError, match="unknown scenario 'UMa'"):
        path_loss_db("UMa", 50.0, 3.75, True)
    with pytest.raises(ValueError, match="clutter height"):
        los_probability("SH", 50.0, clutter_height_m=1.5)
    with pytest.raises(ValueError, match="clutter height"):
        los_probability("DH", 50.0, clutter_height_m=10.0)
    with pytest.raises(ValueError, match="InF-SL by the formula paper_literal needs device height < clutter height"):
        los_probability("SL", 10.0, formula="paper_literal", clutter_height_m=1.0)
    with pytest.raises(ValueError, match="density"):
        los_probability("SL", 50.0, clutter_density=1.0)
    with pytest.raises(ValueError, match="size"):
        los_probability("SL", 50.0, clutter_size_m=0.0)
    with pytest.raises(ValueError, match="2D distance"):
        los_probability("SL", -1.0)
    with pytest.raises(ValueError, match="LoS formula"):
        los_probability("SL", 1.0, formula="winner")
