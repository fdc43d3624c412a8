"""``tsjepa simulate`` from recipe to files, and the plots that are drawn anew from them."""

import csv
import json
from pathlib import Path

import cv2
import pytest

from tsjepa import cli
from tsjepa.evaluation.fleet_pictures import redraw
from tsjepa.paper.age_growth import age_growth
from tsjepa.support.provenance import provenance

RECIPES = Path(__file__).parents[2] / "recipes"
SMALL = ["--seeds=2", "--plants.slots=100", "--radio.resource_blocks=2"]


def simulate(tmp_path, recipe, *options):
    return cli.main(["simulate", "--config", str(RECIPES / recipe), "--output", str(tmp_path), *SMALL, *options])


def test_a_fleet_from_its_recipe(tmp_path, capsys):
    assert simulate(tmp_path, "fleet.yaml", "--num_devices=5", "--schedulers=[channel_aware, oracle]") == 0
    assert "channel_aware" in capsys.readouterr().out
    result = json.loads((tmp_path / "fleet.json").read_text())
    assert result["made_by"]["seeds"] == [0, 1]
    assert result["settings"]["plants"]["process_noise_std"] == 0.008
    assert [row["scheduler"] for row in result["schedulers"]] == ["channel_aware", "oracle"]
    rows = list(csv.DictReader((tmp_path / "devices.csv").open()))
    assert len(rows) == 2 * 2 * 5
    film = cv2.VideoCapture(str(tmp_path / "fleet.mp4"))
    assert int(film.get(cv2.CAP_PROP_FRAME_COUNT)) == 100
    for name in ("scores.png", "ages.png", "fleet.gif"):
        assert (tmp_path / name).stat().st_size > 1000
    redraw(tmp_path / "fleet.json", tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "ages.png").read_bytes()


def test_a_search_from_its_recipe(tmp_path, capsys):
    options = ["--search_over=[2, 5]", "--schedulers=[round_robin, none]", "--controller=linear"]
    assert simulate(tmp_path, "fleet-search.yaml", *options) == 0
    assert "largest I" in capsys.readouterr().out
    result = json.loads((tmp_path / "search.json").read_text())
    assert {row["scheduler"] for row in result["largest"]} == {"round_robin", "none"}
    assert not (tmp_path / "fleet.json").exists()
    redraw(tmp_path / "search.json", tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "search.png").read_bytes()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--num_devices=null"], "search_over"),
        (["--schedulers=[]"], "schedulers"),
        (["--schedulers=[fifo]"], "fifo"),
        (["--seeds=1"], "seeds"),
        (["--plants.slots=1"], "plants.slots"),
        (["--controller=absent"], "absent"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(tmp_path, capsys, options, named):
    assert simulate(tmp_path, "fleet.yaml", "--num_devices=3", *options) == 2
    complaint = capsys.readouterr().err.strip().splitlines()[-1]
    assert named in complaint
    assert "Traceback" not in complaint


def test_the_printed_sign_forgets_devices(tmp_path):
    result = age_growth(str(tmp_path), slots=1500, networks=2)
    traces = {(trace["scheduler"], trace["snr_gate"]): trace for trace in result["traces"]}
    ours, printed = traces["channel_aware", True], traces["channel_aware_literal", True]
    forgetful = traces["channel_aware_literal", False]
    assert 3.003867 < ours["time_average"] < 5.007735  # between the bound and opportunistic
    assert printed["time_average"] > 10 * ours["time_average"]
    assert forgetful["r_squared"] > 0.999
    assert forgetful["growth_per_slot"] == pytest.approx(0.8, abs=0.01)  # 8 of 10 devices are never served
    redraw(tmp_path / "age.json", tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "age.png").read_bytes()


def test_provenance_names_a_command_and_a_commit():
    made = provenance()
    assert set(made) == {"command", "commit", "date"}
    assert all(made.values())
    assert not made["command"].startswith("/")
