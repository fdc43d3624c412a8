"""Other looks: what is drawn, by whom, and the table, against answers that are known."""

import os
from pathlib import Path

import pytest
from tiny_controller import tiny

from tsjepa import cli
from tsjepa.models import entries
from tsjepa.paper import robustness, store, sweep
from tsjepa.paper.rows import loop_of, optimal_of

pytestmark = pytest.mark.slow  # closes loops

RESULTS = Path(__file__).parents[2] / "docs" / "results"
SIZES = {"seeds": 2, "starts": 6, "slots": 60, "process_noise_std": 0.0}
PLAIN = {"condition": "plain", "appearance": {}}


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> str:
    """Folder of a tiny model."""
    folder = tmp_path_factory.mktemp("model") / "tiny"
    entries.save(tiny(), folder)
    return str(folder)


def points(model: str, conditions: list[dict], update_every=(1,)) -> list[dict]:
    return robustness.points({"TS-JEPA": model}, conditions, list(update_every), SIZES)


def test_every_model_meets_every_condition_at_every_period_and_a_condition_may_have_sizes_of_its_own():
    slow = PLAIN | {"condition": "slow", "starts": 2}
    found = robustness.points({"a": "x", "b": "y"}, [PLAIN, slow], [1, 5], SIZES)
    assert [(p["condition"], p["label"], p["model"], p["update_every"], p["starts"]) for p in found] == [
        (condition, label, model, period, starts)
        for condition, starts in (("plain", 6), ("slow", 2))
        for label, model in (("a", "x"), ("b", "y"))
        for period in (1, 5)
    ]


@pytest.mark.parametrize(
    ("appearance", "said"), [({"fog": 1}, "fog"), ({"distractors": 99}, "99"), ({"light": [2, 1]}, "light")]
)
def test_an_appearance_that_cannot_be_is_refused_before_a_loop_runs(appearance, said):
    with pytest.raises(ValueError, match=said):
        points("absent", [PLAIN | {"appearance": appearance}])


def test_a_condition_changes_what_is_seen_and_neither_the_starts_nor_their_normaliser(model):
    shown = {"colors": True, "light": [0.5, 0.6], "distractors": 2}
    plain, other = points(model, [PLAIN, {"condition": "other", "appearance": shown}])
    envs = [loop_of(point).env(0).reset() for point in (plain, other)]
    assert (envs[0]["physics_state"] == envs[1]["physics_state"]).all()
    assert (envs[0]["embedding"] != envs[1]["embedding"]).any()
    rows = [robustness.evaluate(point) for point in (plain, other)]
    assert all({"seed", "score", "failed", "nmae", "gl_renderer"} <= set(row) for found in rows for row in found)
    assert [row["nmae"] for row in rows[0]] != [row["nmae"] for row in rows[1]]
    first, second = (optimal_of(loop_of(point), SIZES["seeds"]) for point in (plain, other))
    assert (first == second).all() and first.any()


def test_a_driver_draws_in_a_process_of_its_own(model, monkeypatch):
    """Of the other renderer only the name and that pictures differ are known."""
    monkeypatch.delenv(robustness.DRIVER, raising=False)
    small = {"seeds": 2, "starts": 6, "slots": 60}
    plain, other = points(model, [PLAIN | small, PLAIN | small | {"condition": "softpipe", "driver": "softpipe"}])
    here, there = robustness.evaluate(plain), robustness.evaluate(other)
    if "llvmpipe" not in here[0]["gl_renderer"]:
        pytest.skip("pictures are not drawn by Mesa's processor here")
    assert all("softpipe" in row["gl_renderer"] for row in there)
    assert [row["nmae"] for row in here] != [row["nmae"] for row in there]
    assert robustness.DRIVER not in os.environ


def test_a_driver_that_does_not_draw_is_named(model, monkeypatch):
    monkeypatch.setenv(robustness.DRIVER, "absent")  # as in the process that would draw
    (point,) = points(model, [PLAIN | {"driver": "absent"}])
    with pytest.raises(RuntimeError, match="although GALLIUM_DRIVER is absent"):
        robustness.evaluate(point)


def test_the_variable_is_as_it_was_before(monkeypatch):
    for before in (None, "", "llvmpipe"):
        monkeypatch.delenv(robustness.DRIVER, raising=False)
        if before is not None:
            monkeypatch.setenv(robustness.DRIVER, before)
        with robustness.environment(robustness.DRIVER, "softpipe"):
            assert os.environ[robustness.DRIVER] == "softpipe"
        assert os.environ.get(robustness.DRIVER) == before


def record(condition: str, label: str, period: int, scores: list[float], failed: float = 0.0, starts: int = 20) -> dict:
    point = {"condition": condition, "label": label, "update_every": period, "seeds": len(scores), "starts": starts}
    rows = [{"seed": seed, "score": score, "nmae": score / 100, "failed": failed} for seed, score in enumerate(scores)]
    return {"point": point, "rows": rows}


def test_the_table_has_means_intervals_and_falls_and_leaves_open_what_is_not_recorded():
    records = [
        record("plain", "TS-JEPA", 1, [0.9, 1.0, 1.1]),
        record("plain", "autoencoder", 1, [0.5, 0.5, 0.5], failed=0.1),
        record("softpipe", "TS-JEPA", 1, [0.4, 0.4], failed=0.5, starts=4),
    ]
    # the half-width of three values 0.1 apart: t = 4.303 times 0.1 over the root of 3
    assert robustness.table(records).splitlines()[:4] == [
        "| score (falls), update in every slot | starts | TS-JEPA | autoencoder |",
        "|---|---|---|---|",
        "| plain | 3 x 20 | 1.000 ± 0.248 (0) | 0.500 ± 0.000 (6) |",
        "| softpipe | 2 x 4 | 0.400 ± 0.000 (4) |  |",
    ]
    assert "| plain | 3 x 20 | 0.0100 ± 0.0025 | 0.0050 ± 0.0000 |" in robustness.table(records)


def test_the_command_records_resumes_and_prints_the_table_and_leaves_out_a_model_that_is_not_there(
    model, tmp_path, capsys, monkeypatch
):
    settings = tmp_path / "settings.yaml"
    settings.write_text(
        "figure: robustness\nsettings:\n"
        f"  models: {{TS-JEPA: {model}, 'TS-JEPA, appearance': {tmp_path}/absent}}\n"
        "  conditions: [{condition: plain, appearance: {}}]\n  update_every: [5]\n"
        "  sizes: {seeds: 2, starts: 6, slots: 60, process_noise_std: 0.0}\n"
    )
    words = ["figures", "--config", str(settings), "--recompute", "true", "--results", str(tmp_path)]
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    assert f"the zoo has no {tmp_path}/absent yet" in said
    assert "| score (falls), update every 5 slots | starts | TS-JEPA |" in said
    assert len(store.read(tmp_path, "robustness")) == 1
    assert (tmp_path / "robustness.png").stat().st_size > 5000
    monkeypatch.setattr(sweep, "launch", lambda module, todo, *rest: iter(()) if not todo else pytest.fail("again"))
    assert cli.main(words) == 0


@pytest.mark.parametrize("path", [*(RESULTS / "figures").glob("robustness.json")])
def test_the_page_has_the_table_of_the_shipped_results(path):
    table = robustness.table(store.read(path.parent, path.stem)).strip()
    assert table in (RESULTS / "robustness.md").read_text()
