"""``tsjepa figures`` and ``tsjepa report``: recipes, plots and pages from recorded files alone."""

import json
from pathlib import Path

import numpy as np
import pytest
import tiny
from PIL import Image

from tsjepa import cli
from tsjepa.paper import FIGURES, claims, command, module_of, store
from tsjepa.paper.film import film
from tsjepa.paper.report import explained

pytestmark = pytest.mark.slow  # draws figures and films

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / command.RESULTS
ZOO = {
    "tsjepa-cartpole",
    *(f"tsjepa-cartpole-d{dimension}" for dimension in (16, 32, 64, 128)),
    "tsjepa-cartpole-appearance",
    "autoencoder-cartpole",
    "supervised-cartpole-k2",
    "supervised-cartpole-k4",
}
FITTED = {folder for folder in map(tiny.exported, map(tiny.merged, tiny.NAMES)) if folder}  # by recipes
CURVE = 20


def recipe_points(figure: str) -> list[dict]:
    return command.points_of(module_of(figure), command.recipe_settings(figure))


def made_up_rows(figure: str, point: dict, numbers: np.random.Generator) -> list[dict]:
    """Rows as the figure's ``evaluate`` makes them, of random numbers."""
    seeds = range(point["seeds"])

    def curve(length: int = CURVE) -> list[float]:
        return numbers.random(length).tolist()

    if figure == "frame_change":
        number = {"median": 1.0, "mean": 1.0, "percentile_90": 2.0, "masked_share": 0.9}
        return [{"seed": seed, **number, "quantiles": sorted(curve(51))} for seed in seeds]
    if figure == "tsne":
        rows = [
            {"seed": seed, "colour_distance": numbers.random(), "neighbour_error": numbers.random()} for seed in seeds
        ]
        count = 30 + 2 * point["marked"]
        rows[0] |= {"x": curve(count), "y": curve(count), "position": curve(30), "angle": curve(30)}
        return rows
    if figure in ("devices_encoding", "devices_prediction", "schedulers"):
        measured = {"num_devices": point.get("also_at", 40), "score": 0.8, "mean_age": 3.0, "failed": 0.1}
        counted = {"bound": "exact", "own_bound": "exact"}
        return [{"seed": seed, **measured} for seed in seeds] + [
            {"seed": seed, "devices": 10 + 50 * numbers.random(), **counted} for seed in seeds
        ]
    loops = [{}]
    if figure == "dataset_size":
        loops = [{"update_every": period} for period in (1, 5, 10, 0)]
    if figure == "target_snr":
        loops = [{"snr_target_db": snr, "loss": loss} for snr in point["loop_snr_db"] for loss in (0.0, 0.3)]
    measures = ("score", "raw_score", "failed", "cost", "nmae")
    return [
        loop
        | {
            "seed": seed,
            "bits_per_slot": 10 + 1000 * numbers.random(),
            "effective_rank": 9.0,
            "in_box": curve(),
            "nmae_by_slot": curve(),
        }
        | dict(zip(measures, numbers.random(len(measures)).tolist(), strict=True))
        for loop in loops
        for seed in seeds
    ]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """Results of every figure, made up."""
    folder = tmp_path_factory.mktemp("results")
    numbers = np.random.default_rng(0)
    made_by = {"command": "tsjepa figures", "commit": "0123456789", "date": "2026-01-01"}
    for figure in FIGURES:
        store.write(
            folder,
            figure,
            [
                {
                    "point": point,
                    "rows": store.rounded(made_up_rows(figure, point, numbers)),
                    "seconds": 1.0,
                    "weights": {},
                    "made_by": made_by,
                }
                for point in recipe_points(figure)
            ],
        )
    return folder


@pytest.mark.parametrize("figure", FIGURES)
def test_every_recipe_names_its_command_and_a_sweep_of_five_seeds(figure):
    name = f"recipes/figures/{figure}.yaml"
    assert tiny.command_of(name)[0] == "figures"
    assert tiny.load(name)["figure"] == figure
    points = recipe_points(figure)
    assert len({store.key(point) for point in points}) == len(points)
    assert {point["model"] for point in points if point.get("model")} <= ZOO | FITTED
    checks = [point for point in points if point["seeds"] < 5]
    assert [point["label"] for point in checks] == (["TS-JEPA, 20 MHz"] if figure == "devices_encoding" else [])


def test_every_figure_has_a_recipe():
    assert {path.stem for path in (ROOT / "recipes/figures").glob("*.yaml")} == set(FIGURES)


@pytest.mark.parametrize("figure", FIGURES)
def test_a_plot_is_redrawn_from_its_file_alone(figure, recorded, monkeypatch):
    monkeypatch.setattr(module_of(figure), "evaluate", lambda point: pytest.fail("a sweep ran"))
    drawn = []
    for _ in range(2):
        assert cli.main(["figures", "--figure", figure, "--results", str(recorded)]) == 0
        drawn.append((recorded / f"{figure}.png").read_bytes())
    assert drawn[0] == drawn[1]
    assert len(drawn[0]) > 5000


@pytest.mark.parametrize("figure", FIGURES)
def test_a_figure_judges_all_its_claims_and_no_others(figure, recorded):
    found = module_of(figure).verdicts(store.read(recorded, figure))
    assert set(found) == {name for name, claim in claims.CLAIMS.items() if claim.figure == figure}
    assert all(v.verdict in (claims.REPRODUCED, claims.PARTLY, claims.NOT) and v.ours for v in found.values())
    assert all(v.reason for v in found.values() if v.verdict != claims.REPRODUCED)


@pytest.mark.parametrize("figure", FIGURES)
def test_a_sweep_that_is_not_done_yet_can_be_drawn_and_judged(figure, recorded, tmp_path):
    records = store.read(recorded, figure)
    for count in {1, len(records) // 2} - {0}:
        module_of(figure).draw(records[:count], tmp_path / "picture.png")
        module_of(figure).verdicts(records[:count])


def test_the_report_has_a_line_for_every_claim_and_holds_its_pictures(recorded, tmp_path):
    assert cli.main(["report", "--output", str(tmp_path), "--results", str(recorded)]) == 0
    text, page = (tmp_path / "report.md").read_text(), (tmp_path / "report.html").read_text()
    assert all(f"| {claim.text} |" in text for claim in claims.CLAIMS.values())
    figures = {claim.figure for claim in claims.CLAIMS.values()}
    assert figures == set(FIGURES) - {"robustness"}  # of which the paper claims nothing
    assert all(module_of(figure).TITLE in text for figure in figures)
    assert page.count('src="data:image/png;base64,') == len(figures)
    assert "http" not in page
    assert claims.UNMEASURED not in text


def test_a_verdict_from_part_of_a_sweep_says_so(recorded, tmp_path):
    records = store.read(recorded, "frame_change")
    store.write(tmp_path / "part", "frame_change", records[:-1])
    assert cli.main(["report", "--output", str(tmp_path), "--results", str(tmp_path / "part")]) == 0
    text = (tmp_path / "report.md").read_text()
    assert f"from {len(records) - 1} of {len(records)} points of the sweep" in text


def test_figures_and_reason_are_joined_where_there_are_both():
    both = [("1", "because"), ("1", ""), ("", "because"), ("", "")]
    said = [explained(claims.Verdict(claims.PARTLY, *parts)) for parts in both]
    assert said == ["1; because", "1", "because", ""]


def test_without_results_every_claim_is_said_to_be_unmeasured(tmp_path, capsys):
    assert cli.main(["report", "--output", str(tmp_path), "--results", str(tmp_path / "none")]) == 0
    assert f"{len(claims.CLAIMS)} {claims.UNMEASURED}" in capsys.readouterr().out
    assert "recipes/figures/bits.yaml --recompute true" in (tmp_path / "report.md").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--figure", "absent"], "'absent'"),
        (["--settings", "{seeds: 3}"], "name it"),
        (["--check", "true", "--recompute", "true"], "choose one"),
        (["--figure", "tsne", "--check", "true", "--settings", "{seeds: 3}"], "add --recompute true"),
        (["--workers", "0"], "workers is 0"),
        (["--figure", "tsne", "--recompute", "true", "--settings", "{seeds: 3}"], "marked"),
    ],
)
def test_wrong_options_are_answered_in_one_sentence(options, said, capsys, tmp_path):
    assert cli.main(["figures", "--results", str(tmp_path), *options]) == 2
    complaint = capsys.readouterr().err
    assert said in complaint and len(complaint.splitlines()) == 1


def test_a_small_sweep_by_the_command_and_its_check(tmp_path, capsys):
    settings = {"intervals_ms": [20, 40], "augmentations": ["none"], "seeds": 2, "episodes": 1, "pairs": 2}
    options = ["figures", "--figure", "frame_change", "--results", str(tmp_path)]
    assert cli.main([*options, "--settings", json.dumps(settings), "--recompute", "true"]) == 0
    assert len(store.read(tmp_path, "frame_change")) == 2
    assert cli.main([*options, "--check", "true"]) == 0
    assert capsys.readouterr().out.count("agrees") == 2
    records = store.read(tmp_path, "frame_change")
    for record in records:
        for row in record["rows"]:
            row["median"] = 100.0
    store.write(tmp_path, "frame_change", records)
    assert cli.main([*options, "--check", "true"]) == 1
    assert "frame_change (median" in capsys.readouterr().err


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_shipped_results_name_their_command_commit_and_seeds(path):
    figure = path.stem
    points = {store.key(point) for point in recipe_points(figure)}
    records = store.read(RESULTS, figure)
    assert {store.key(record["point"]) for record in records} <= points
    assert all(f"recipes/figures/{figure}.yaml" in record["made_by"]["command"] for record in records)
    assert all(record["made_by"]["commit"] and record["made_by"]["date"] for record in records)
    assert all(len({row["seed"] for row in record["rows"]}) == record["point"]["seeds"] for record in records)
    assert path.with_suffix(".csv").read_text() == store.tidy(records)
    assert path.with_suffix(".png").is_file()


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_shipped_results_are_drawn_anew(path, tmp_path):
    module_of(path.stem).draw(store.read(RESULTS, path.stem), tmp_path / "picture.png")
    with Image.open(tmp_path / "picture.png") as picture:
        drawn = np.asarray(picture.convert("L"), float)
    assert min(drawn.shape) > 200
    assert drawn.std() > 10 and 0.01 < (drawn < 200).mean() < 0.9


def test_the_film_shows_both_fleets_moving(tmp_path):
    film(str(tmp_path), num_devices=2, theirs="tsjepa-cartpole", slots=6)
    with Image.open(tmp_path / "fleet.gif") as gif:
        assert (gif.width, gif.n_frames) == (800, 3)
        pictures = []
        for index in range(gif.n_frames):
            gif.seek(index)
            pictures.append(np.asarray(gif.convert("RGB"), np.int16))
    halves = [(picture[:, :400], picture[:, 400:]) for picture in pictures]
    assert all(np.ptp(half) > 100 for pair in halves for half in pair)
    assert all(np.abs(after - before).max() > 50 for before, after in zip(halves[0], halves[-1], strict=True))
