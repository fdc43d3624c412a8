"""``tsjepa simulate`` from recipe to files, and the plots that are drawn anew from them."""

import csv
import json
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import tiny_controller
import torch
from open_plant import OpenPlant

from tsjepa import cli
from tsjepa.envs import Radio
from tsjepa.evaluation import rollouts
from tsjepa.evaluation import simulate as simulation
from tsjepa.evaluation.fleet_film import BORDER, DELIVERED, FAILED, GOOD, LOST, SILENT, grid_columns, tile, tile_size
from tsjepa.evaluation.fleet_pictures import age_plot, capacity_plot
from tsjepa.evaluation.rollouts import Loop, run
from tsjepa.models import entries
from tsjepa.plants import CartPole
from tsjepa.radio import SCHEDULERS, periodic
from tsjepa.support import provenance

RECIPES = Path(__file__).parents[2] / "recipes"
SMALL = ["--seeds=2", "--slots=100", "--radio.resource_blocks=2"]
PLANT = CartPole()


def simulate(tmp_path, recipe, *options):
    return cli.main(["simulate", "--config", str(RECIPES / recipe), "--output", str(tmp_path), *SMALL, *options])


@pytest.mark.slow
def test_a_fleet_from_its_recipe(tmp_path, capsys):
    options = ["--num_devices=5", "--schedulers=[channel_aware, oracle]", "--video=false"]
    assert simulate(tmp_path, "fleet.yaml", *options) == 0
    assert "channel_aware" in capsys.readouterr().out
    result = json.loads((tmp_path / "fleet.json").read_text())
    assert result["made_by"]["seeds"] == [0, 1]
    assert result["settings"]["plant"]["init_args"]["process_noise_std"] == [0.008, 0.008]
    assert result["optimal_policy"] == "reference LQR"
    assert [row["scheduler"] for row in result["schedulers"]] == ["channel_aware", "oracle"]
    rows = list(csv.DictReader((tmp_path / "devices.csv").open()))
    assert len(rows) == 2 * 2 * 5
    for name in ("scores.png", "ages.png"):
        assert (tmp_path / name).stat().st_size > 1000
    age_plot(result["schedulers"], tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "ages.png").read_bytes()


@pytest.mark.slow
def test_a_scheduler_of_ones_own_by_its_import_path(tmp_path, capsys, monkeypatch):
    program = "from tsjepa.radio import SCHEDULERS\n\n\ndef patient(known):\n    return SCHEDULERS['max_age'](known)\n"
    (tmp_path / "my_waiting_list.py").write_text(program)
    monkeypatch.syspath_prepend(str(tmp_path))
    options = ["--num_devices=4", "--schedulers=[my_waiting_list.patient, max_age]", "--video=false"]
    assert simulate(tmp_path, "fleet.yaml", *options) == 2
    assert "my_waiting_list.patient is not this package's own: add --trust" in capsys.readouterr().err
    assert simulate(tmp_path, "fleet.yaml", *options, "--trust") == 0
    own, built_in = json.loads((tmp_path / "fleet.json").read_text())["schedulers"]
    assert own == built_in | {"scheduler": "my_waiting_list.patient"}


@pytest.mark.slow
def test_a_search_from_its_recipe(tmp_path, capsys):
    options = ["--search_over=[2, 5]", "--schedulers=[round_robin, none]", "--controller=linear"]
    assert simulate(tmp_path, "fleet-search.yaml", *options) == 0
    assert "largest I" in capsys.readouterr().out
    result = json.loads((tmp_path / "search.json").read_text())
    assert {row["scheduler"] for row in result["largest"]} == {"round_robin", "none"}
    assert not (tmp_path / "fleet.json").exists()
    capacity_plot(result, tmp_path / "again.png")
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "search.png").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("make", ["tiny", "tiny_supervised", "tiny_autoencoder"])
def test_every_kind_of_model_controls_a_fleet_of_its_own_plants_and_is_filmed(tmp_path, make):
    entry = entries.save(getattr(tiny_controller, make)(), tmp_path / "model")
    result = simulation.simulate(
        6, ["round_robin"], str(entry), Radio(resource_blocks=2), slots=80, seeds=2, output=str(tmp_path)
    )
    assert result["fleet"]["settings"]["plant"]["class_path"] == "tsjepa.plants.CartPole"
    assert result["fleet"]["model_sha256"] == entries.fingerprint(entry)
    written = json.loads((tmp_path / "fleet.json").read_text())
    assert written["camera"]["gl_renderer"] == PLANT.camera()["gl_renderer"]
    (row,) = result["fleet"]["schedulers"]
    assert row["bits_per_device_and_slot"] == pytest.approx(32 * tiny_controller.DIM * 2 / 6)
    film = cv2.VideoCapture(str(tmp_path / "fleet.mp4"))
    assert int(film.get(cv2.CAP_PROP_FRAME_COUNT)) == 80
    assert (tmp_path / "fleet.gif").stat().st_size > 1000


@pytest.mark.slow
def test_a_scheduler_of_the_users_own_is_named_by_its_function(tmp_path):
    def nobody(known):
        return torch.zeros_like(known.candidate), known.memory

    options = {"plant": PLANT, "slots": 90, "seeds": 2, "output": str(tmp_path), "video": False}
    (row,) = simulation.simulate(6, [nobody], "hold", Radio(resource_blocks=2), **options)["fleet"]["schedulers"]
    assert row["scheduler"] == "nobody"
    assert row["bits_per_device_and_slot"] == 0
    twice = [SCHEDULERS["max_age"], "max_age"]
    with pytest.raises(ValueError, match="max_age, max_age two have one name"):
        simulation.simulate(6, twice, "hold", Radio(resource_blocks=2), **options)


@pytest.mark.slow
def test_schedulers_that_are_made_of_others_have_rows_and_searches_of_their_own(tmp_path):
    made = [periodic(2), periodic(3), partial(SCHEDULERS["channel_aware"], age_weight=2.0)]
    options = {"plant": PLANT, "slots": 90, "seeds": 2, "output": str(tmp_path), "video": False}
    result = simulation.simulate(6, made, "hold", Radio(resource_blocks=2), search_over=[5, 6], **options)
    names = ["periodic(2)", "periodic(3)", "channel_aware(age_weight=2.0)"]
    assert [row["scheduler"] for row in result["fleet"]["schedulers"]] == names
    assert {row["scheduler"] for row in result["search"]["largest"]} == set(names)


@pytest.mark.slow
def test_the_normalisers_plants_start_as_those_of_a_model_with_a_longer_stack(tmp_path, monkeypatch):
    entry = entries.save(tiny_controller.tiny_supervised(frame_stack=4), tmp_path / "model")
    started = {}

    def noted(loop, seed):
        started.setdefault(loop.controller if isinstance(loop.controller, str) else "model", []).append(
            loop.env(seed).reset()["physics_state"]
        )
        return rollouts_run(loop, seed)

    rollouts_run = rollouts.run
    monkeypatch.setattr(rollouts, "run", noted)
    monkeypatch.setattr(simulation, "run", noted)
    options = {"slots": 90, "seeds": 2, "output": str(tmp_path / "out"), "video": False}
    fleet = (Radio(resource_blocks=3), PLANT)
    simulation.simulate(None, ["round_robin"], str(entry), *fleet, search_over=[5, 6], **options)
    (expert, model) = started.values()
    assert torch.equal(expert[0][:5], model[0][:5])


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--num_devices=null"], "search_over"),
        (["--schedulers=[]"], "schedulers"),
        (["--schedulers=[fifo]"], "fifo"),
        (["--schedulers=[chanel_aware]"], "did you mean channel_aware?"),
        (["--seeds=1"], "seeds is 1"),
        (["--slots=1"], "take more slots"),
        (["--controller=absent"], "choose the folder of a model, or hold, zero, linear, exact"),
        (["--controller=hodl"], "did you mean hold?"),
        ([f"--controller={Path(__file__).parent}"], "There is no model "),
        (["--plant=null"], "give plant"),
    ],
)
def test_what_is_wrong_is_said_in_one_short_sentence(tmp_path, capsys, options, named):
    assert simulate(tmp_path, "fleet.yaml", "--num_devices=3", "--video=false", *options) == 2
    complaint = capsys.readouterr().err.strip().splitlines()[-1]
    assert named in complaint
    assert len(complaint) < 400
    assert "Traceback" not in complaint


def test_what_a_users_scheduler_cannot_answer_is_said_before_the_normaliser_runs(tmp_path, monkeypatch):
    def greedy(known):
        return known.candidate, known.memory

    monkeypatch.setattr(simulation, "optimal_scores", lambda *_: pytest.fail("too late"))
    options = {"plant": PLANT, "output": str(tmp_path / "out"), "video": False}
    with pytest.raises(ValueError, match="greedy granted up to 4 units beyond the budget"):
        simulation.simulate(6, ["max_age", greedy], "hold", Radio(resource_blocks=2), **options)
    assert not (tmp_path / "out").exists()


class Stopped(RuntimeError):
    pass


@pytest.fixture
def interrupted(tmp_path, monkeypatch):
    """A function that searches, and is stopped after a number of fleets; it gives the fleets that it has run."""

    def searched(after: int | None = None, **changes) -> list[tuple[int, int]]:
        done, real = [], simulation.run

        def counted(loop, seed):
            if after is not None and len(done) == after:
                raise Stopped
            done.append((loop.num_devices, seed))
            return real(loop, seed)

        options = {"plant": PLANT, "slots": 80, "seeds": 2, "output": str(tmp_path), "search_over": [6, 7]}
        with monkeypatch.context() as patch:
            patch.setattr(simulation, "run", counted)
            try:
                simulation.simulate(None, ["oracle"], **(options | changes))
            except Stopped:
                assert after is not None
        return done

    return searched


@pytest.mark.slow
def test_a_search_that_was_killed_goes_on_where_it_was(interrupted):
    assert interrupted(after=3) == [(6, 0), (6, 1), (7, 0)]
    assert interrupted() == [(7, 1)]


@pytest.mark.slow
def test_a_search_on_a_trace_goes_on_with_this_very_trace_alone(interrupted, tmp_path):
    path = tmp_path / "links.csv"
    on_trace = {"radio": Radio(trace=str(path))}
    path.write_text("time_s,snr_db\n0,10\n1,12\n")
    assert interrupted(after=3, **on_trace) == [(6, 0), (6, 1), (7, 0)]
    assert interrupted(after=1, **on_trace) == [(7, 1)]
    interrupted(after=3, **on_trace)
    path.write_text("time_s,snr_db\n0,10\n1,13\n")
    assert interrupted(**on_trace) == [(6, 0), (6, 1), (7, 0), (7, 1)]


@pytest.mark.slow
def test_other_code_another_plant_or_another_normaliser_start_a_search_anew(interrupted, monkeypatch):
    whole = [(6, 0), (6, 1), (7, 0), (7, 1)]
    interrupted(after=2)
    with monkeypatch.context() as patch:
        patch.setattr(simulation, "code_hash", lambda *others: "edited")
        assert interrupted(after=2) == whole[:2]
    noisy = CartPole(process_noise_std=0.001)
    assert interrupted(after=2, plant=noisy) == whole[:2]
    with monkeypatch.context() as patch:
        patch.setattr("tsjepa.plants.CartPole.normaliser", "expert")
        assert interrupted(after=2, plant=noisy) == whole[:2]
        assert interrupted(plant=noisy) == whole[2:]


def test_the_hash_of_the_code_knows_an_edit_of_the_package_and_of_the_users_own_files(tmp_path, monkeypatch):
    package = tmp_path / "tsjepa"
    (package / "support").mkdir(parents=True)
    source = package / "module.py"
    source.write_text("a = 1\n")
    monkeypatch.setattr(provenance, "__file__", str(package / "support" / "provenance.py"))
    before = provenance.code_hash()
    assert provenance.code_hash() == before
    source.write_text("a = 2\n")
    edited = provenance.code_hash()
    assert provenance.code_hash(simulation) == provenance.code_hash(simulation)  # a module is of its file
    assert len({before, edited, provenance.code_hash(SCHEDULERS["random"]), provenance.code_hash(OpenPlant)}) == 4


@pytest.mark.parametrize(
    ("frame", "count", "size", "columns"), [((64, 128), 40, (48, 96), 7), ((64, 64), 40, (96, 96), 9)]
)
def test_a_films_tiles_have_the_proportions_of_the_camera(frame, count, size, columns):
    assert tile_size(frame) == size
    assert grid_columns(count, *size) == columns


def test_a_tile_shows_the_picture_and_what_became_of_the_transmission():
    loop = Loop(OpenPlant(), scheduler="round_robin", num_devices=4, slots=40, radio=Radio(resource_blocks=1))
    outcome = run(loop, 0)
    white = np.full((48, 96, 3), 255, np.uint8)
    borders = {}
    for slot in range(40):
        for device in range(4):
            shown = tile(white, outcome, slot, device, False, 1.0)
            sent, arrived = bool(outcome.scheduled[slot, device]), bool(outcome.delivered[slot, device])
            borders.setdefault((sent, arrived), set()).add(tuple(shown[1, 50].tolist()))
            if int(outcome.age[slot, device]) == 1:
                assert tuple(shown[24, 60]) == (255, 255, 255)
    assert borders == {(True, True): {DELIVERED}, (True, False): {LOST}, (False, False): {SILENT}}
    row = 48 - BORDER - 2
    full, half = (tile(white, outcome, 0, 0, False, score)[row] for score in (1.0, 0.5))
    assert (full[BORDER : 96 - BORDER] == GOOD).all()
    assert (half == GOOD).all(1).sum() == (96 - 2 * BORDER) // 2
    failed = tile(white, outcome, 0, 0, True, 0.0)[24, 60]
    assert (np.abs(failed - (255 + 0.6 * (np.array(FAILED) - 255))) <= 1).all()


def test_more_blocks_than_devices_are_refused():
    with pytest.raises(ValueError, match=r"resource_blocks is 50 and the fleet has 40 devices: give at most 40"):
        simulation.simulate(40, plant=CartPole(), radio=Radio(resource_blocks=50))
