"""Sweeps: what is recorded, interrupted and resumed, spread over processes, and repeated for a check."""

import csv
import json

import pytest
import toy_figure

from tsjepa.paper import launchers, store, sweep


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "results").mkdir()
    return tmp_path


def run(folder, count=4, launcher="serial"):
    return sweep.run_sweep(toy_figure, toy_figure.points(count, str(folder)), folder / "results", launcher, 2)


def calls(folder) -> list[int]:
    return [int(line) for line in (folder / "calls").read_text().split()]


def numbers(records) -> list:
    return [(record["point"], record["rows"]) for record in records]


def test_a_sweep_is_recorded_with_its_origin(folder):
    records = run(folder)
    assert records == store.read(folder / "results", "toy_figure")
    assert [record["point"]["x"] for record in records] == [0, 1, 2, 3]
    assert all({"command", "commit", "date"} <= set(record["made_by"]) for record in records)
    with (folder / "results" / "toy_figure.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["x"]), int(row["seed"])) for row in rows] == [(x, seed) for x in range(4) for seed in range(3)]
    assert all(row["commit"] and row["command"] and "curve" not in row for row in rows)
    assert float(rows[5]["value"]) == records[1]["rows"][2]["value"]


def test_an_interrupted_sweep_keeps_what_is_done_and_goes_on_there(folder):
    (folder / "interrupt").touch()
    with pytest.raises(KeyboardInterrupt):
        run(folder)
    assert [record["point"]["x"] for record in store.read(folder / "results", "toy_figure")] == [0, 1]
    (folder / "interrupt").unlink()
    records = run(folder)
    assert calls(folder) == [0, 1, 2, 3]
    assert [record["point"]["x"] for record in records] == [0, 1, 2, 3]
    assert run(folder) == records
    assert calls(folder) == [0, 1, 2, 3]


def test_a_scheduler_that_must_not_be_imported_is_refused_before_any_point_runs(folder):
    points = toy_figure.points(3, str(folder))
    points[2]["scheduler"] = "own_schedulers.nearest"
    with pytest.raises(ValueError, match=r"own_schedulers\.nearest is not this package's own: add --trust"):
        sweep.run_sweep(toy_figure, points, folder / "results")
    assert not (folder / "calls").exists()


def test_the_file_follows_the_sweep(folder):
    run(folder, 4)
    assert [record["point"]["x"] for record in run(folder, 2)] == [0, 1]
    run(folder, 3)
    assert [record["point"]["x"] for record in store.read(folder / "results", "toy_figure")] == [0, 1, 2]
    assert calls(folder) == [0, 1, 2, 3, 2]


@pytest.mark.slow
def test_processes_give_the_same_numbers_and_a_killed_worker_costs_its_point_alone(folder, tmp_path_factory):
    serial = tmp_path_factory.mktemp("serial")
    (folder / "kill").touch()
    spread = run(folder, launcher="processes")
    assert not (folder / "kill").exists()
    assert sorted(set(calls(folder))) == [0, 1, 2, 3]
    assert [rows for _, rows in numbers(spread)] == [rows for _, rows in numbers(run(serial))]


def test_points_are_evaluated_again_with_other_weights_and_wait_for_a_model_that_is_not_there(
    folder, monkeypatch, capsys
):
    points = [{"x": x, "seeds": 2, "folder": str(folder), "model": f"model-{x}"} for x in range(2)]
    digests = {"model-0": "aaa", "model-1": None}
    monkeypatch.setattr(sweep, "weights_of", lambda model: digests[model])

    def again() -> list[dict]:
        return sweep.run_sweep(toy_figure, points, folder / "results")

    assert [record["weights"] for record in again()] == [{"model-0": "aaa"}]
    assert "model-1" in capsys.readouterr().out
    digests["model-1"] = "bbb"
    assert len(again()) == 2
    assert calls(folder) == [0, 1]
    digests["model-0"] = "ccc"
    assert again()[0]["weights"] == {"model-0": "ccc"}
    assert calls(folder) == [0, 1, 0]


def test_points_of_other_code_are_evaluated_again_and_those_of_the_same_kept(folder, monkeypatch):
    records = run(folder, 2)
    assert all(record["code"] == sweep.code_hash(toy_figure)[:12] for record in records)
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "code_hash", lambda *others: "edited" * 4)
        (folder / "interrupt").touch()
        with pytest.raises(KeyboardInterrupt):
            run(folder, 3)
        (folder / "interrupt").unlink()
        assert calls(folder) == [0, 1, 0, 1]
        run(folder, 3)
        assert calls(folder) == [0, 1, 0, 1, 2]
    # records that do not say by which code they were made are made anew
    old = [{name: value for name, value in record.items() if name != "code"} for record in records]
    store.write(folder / "results", "toy_figure", old)
    assert numbers(run(folder, 2)) == numbers(records)
    assert calls(folder) == [0, 1, 0, 1, 2, 0, 1]


def test_points_that_train_are_evaluated_again_by_other_recipes_and_not_checked_against_them(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "jepa.yaml").write_text("steps: 1")
    points = [{"x": 0, "seeds": 2, "folder": str(folder), "jepa_recipe": "jepa.yaml"}]
    records = sweep.run_sweep(toy_figure, points, folder / "results")
    assert sweep.run_sweep(toy_figure, points, folder / "results") == records
    assert len(sweep.check(toy_figure, records)) == 1
    (folder / "jepa.yaml").write_text("steps: 2")
    assert sweep.check(toy_figure, records) == []
    assert sweep.run_sweep(toy_figure, points, folder / "results")[0]["weights"] != records[0]["weights"]
    assert calls(folder) == [0, 0, 0]


def test_a_check_repeats_the_quickest_point_and_sees_a_value_that_left_its_interval(folder):
    records = run(folder)
    records[1]["seconds"] = -1.0
    (row,) = sweep.check(toy_figure, records)
    assert (row["point"]["x"], row["agrees"]) == (1, True)
    assert row["now"] == pytest.approx(row["recorded"])
    half = row["interval_95"]
    for index, shift in enumerate((0.9 * half, 1.1 * half)):
        shifted = json.loads(json.dumps(records))
        for recorded in shifted[1]["rows"]:
            recorded["value"] += shift
        (row,) = sweep.check(toy_figure, shifted)
        assert row["agrees"] == (index == 0)


def test_an_unknown_launcher_is_named(folder):
    with pytest.raises(ValueError, match="'cloud'"):
        list(launchers.launch("toy_figure", [], "cloud", 1))
