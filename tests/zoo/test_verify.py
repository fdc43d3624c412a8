"""``tsjepa export`` and ``tsjepa zoo``: from a run to an entry, to the list, and to scores that are measured again."""

import json
from pathlib import Path

import pytest
import torch
import yaml
from tiny_controller import frames, tiny, tiny_supervised

import tsjepa
from tsjepa import cli
from tsjepa.evaluation.summary import FIRST_LOST
from tsjepa.models import Observer, entries
from tsjepa.zoo import export as export_module
from tsjepa.zoo.card import card
from tsjepa.zoo.export import export
from tsjepa.zoo.figures import HEADINGS, key_figures, seed_figures, table
from tsjepa.zoo.training_history import training_history
from tsjepa.zoo.verify import Check, failures_allowed

POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 1741\n"
SMALL = {"periods": (5,), "seeds": 2, "starts_per_seed": 6, "slots": 80, "video": False, "data": None}
METADATA = {"slot": 0.02, "slots": 100, "seed": 0, "sha256": "5e", "files": {}}


def write_run(folder: str, model, pretrained: str | None, **metrics) -> None:
    """What a fit leaves: the model, and the configuration as Lightning writes it."""
    entries.save(model, f"{folder}/model", metrics)
    config = {
        "seed_everything": 3,
        # only the module's own start counts, and only the data module's own path
        "trainer": {"logger": {"init_args": {"path": "elsewhere"}}},
        "model": {
            "class_path": "a.Module",
            "init_args": {"encoder": {"init_args": {"pretrained": "absent"}}, "pretrained": pretrained},
        },
        "data": {"class_path": "a.Data", "init_args": {"augmentation": {"path": "no"}, "path": "data/tiny"}},
    }
    Path(folder, "config.yaml").write_text(yaml.safe_dump(config))


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder with two runs, the second of which starts from the first, and the first's data set."""
    folder = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        made_by = {"command": "tsjepa fit --config recipes/jepa.yaml", "commit": "abc", "date": "2026-01-01"}
        write_run("runs/jepa", tiny(0), None, made_by=made_by)
        write_run("runs/actor", tiny(1), "runs/jepa/model")
        Path("data/tiny").mkdir(parents=True)
        splits = {"train": {"episodes": 180, "coverage": True}, "test": {"episodes": 40, "coverage": False}}
        Path("data/tiny/metadata.json").write_text(json.dumps({"format": 1, "splits": splits, **METADATA}))
    return folder


@pytest.fixture
def evaluations(home, monkeypatch):
    """Runs the test in ``home``; the options of every evaluation that is made there, each a small one."""
    monkeypatch.chdir(home)
    made, real = [], export_module.evaluate

    def small(model: str, output: str, data: str | None) -> dict:
        made.append((model, output, data))
        return real(model, output=output, **SMALL)

    monkeypatch.setattr(export_module, "evaluate", small)
    return made


@pytest.fixture
def entry(evaluations):
    """The second run as an entry."""
    export("runs/actor", "tiny", trained_with="One core in 3 minutes.")
    return Path("checkpoints/tiny")


@pytest.mark.slow
def test_a_run_becomes_an_entry_with_one_command_and_is_evaluated_once(evaluations, home, capsys):
    (home / "runs/actor/evaluation/evaluation.json").unlink(missing_ok=True)
    assert cli.main(["export", "runs/actor", "first", "--folder", "exported"]) == 0
    assert evaluations == [(str(Path("runs/actor/model")), str(Path("runs/actor/evaluation")), "data/tiny")]
    assert capsys.readouterr().out.splitlines()[-2:] == [
        f"first written to {Path('exported/first')}.",
        f"Next, score it again from its files: tsjepa zoo verify {Path('exported/first')}",
    ]
    assert cli.main(["export", "runs/actor/model", "second", "--folder", "exported"]) == 0
    assert len(evaluations) == 1
    first, second = (tsjepa.load(f"exported/{name}") for name in ("first", "second"))
    assert torch.equal(first.code_low, tiny(1).code_low)
    assert first.metrics == second.metrics
    assert first.metrics["seeds"] == [0, 1]
    assert {"command", "commit", "date"} <= set(first.metrics["made_by"])
    assert {"processor", "cores"} <= set(first.metrics["machine"])


def test_an_entry_says_how_it_was_trained(entry):
    metrics = json.loads((entry / entries.METRICS).read_text())
    first = {"command": "tsjepa fit --config recipes/jepa.yaml", "commit": "abc", "date": "2026-01-01"}
    second = {"command": "tsjepa fit --config runs/actor/config.yaml"}
    assert metrics["training"] == [fit | {"seed": 3, "data": "data/tiny"} for fit in (first, second)]
    (data,) = metrics["data_sets"]
    assert data["path"] == "data/tiny"
    assert data["episodes"] == {"train": 180, "test": 40}
    text = (entry / entries.CARD).read_text()
    for line in (
        "- `tsjepa fit --config recipes/jepa.yaml` (seed 3, commit abc, 2026-01-01)",
        "- `tsjepa fit --config runs/actor/config.yaml` (seed 3)",
        "- data `data/tiny`, episodes of 100 slots of 20 ms: 180 train, 40 test",
        "- One core in 3 minutes.",
        f"- {sum(parameter.numel() for parameter in tiny().parameters()):,} parameters, stored as float32",
    ):
        assert line in text.splitlines()


def test_a_model_that_started_from_an_entry_continues_its_history(entry):
    write_run("runs/next", tiny(2), "checkpoints/tiny")
    history = training_history(Path("runs/next/model"))
    assert [fit["command"] for fit in history] == [
        "tsjepa fit --config recipes/jepa.yaml",
        "tsjepa fit --config runs/actor/config.yaml",
        "tsjepa fit --config runs/next/config.yaml",
    ]


@pytest.mark.slow
def test_runs_that_started_from_each_other_have_a_history_that_ends(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_run("runs/jepa", tiny(0), "runs/actor/model")
    write_run("runs/actor", tiny(1), "runs/jepa/model")
    write_run("runs/own", tiny(2), "runs/own/model")
    commands = [fit["command"] for fit in training_history(Path("runs/actor/model"))]
    assert commands == [f"tsjepa fit --config runs/{name}/config.yaml" for name in ("jepa", "actor")]
    assert len(training_history(Path("runs/own/model"))) == 1


def test_a_damaged_figure_file_of_a_run_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_run("runs/jepa", tiny(0), None)
    Path("runs/jepa/model/metrics.json").write_text('{"made_by')
    with pytest.raises(ValueError, match=r"runs/jepa/model/metrics\.json is damaged: it is no JSON"):
        training_history(Path("runs/jepa/model"))


def test_other_weights_are_evaluated_anew_and_never_given_the_figures_of_others(entry, evaluations):
    Path("runs/again/evaluation").mkdir(parents=True)
    write_run("runs/again", tiny(2), None)
    figures = Path("runs/actor/evaluation/evaluation.json")
    with pytest.raises(ValueError, match="is not about the weights in"):
        export("runs/again", "again", evaluation=str(figures))
    with pytest.raises(FileNotFoundError, match=r"no evaluation absent\.json"):
        export("runs/again", "again", evaluation="absent.json")
    Path("runs/again/evaluation/evaluation.json").write_text(figures.read_text())
    evaluations.clear()
    export("runs/again", "again")
    assert len(evaluations) == 1
    own, other = (json.loads(Path(f"checkpoints/{name}/metrics.json").read_text()) for name in ("again", "tiny"))
    assert own["model_sha256"] == entries.fingerprint("runs/again/model") != other["model_sha256"]


def test_names_that_are_none_are_refused(evaluations):
    for name in ("", ".", "..", "../tiny", "zoo/tiny", "tiny/"):
        with pytest.raises(ValueError, match="is no name of an entry"):
            export("runs/actor", name)
    with pytest.raises(FileNotFoundError, match="no model 'runs/absent'"):
        export("runs/absent", "tiny")


@pytest.mark.slow
def test_an_entry_may_leave_its_decoder_out(entry):
    export("runs/actor", "whole"), export("runs/actor", "without", decoder=False)
    whole, without = (tsjepa.load(f"checkpoints/{name}") for name in ("whole", "without"))
    assert whole.decoder is not None and without.decoder is None
    assert torch.equal(whole.encode(frames()), without.encode(frames()))


@pytest.mark.slow
def test_16_bits_are_scored_before_they_are_shipped(entry, monkeypatch):
    export("runs/actor", "half", half=True)
    model = tsjepa.load("checkpoints/half")
    assert model.metrics["weights"]["dtype"] == "float16"
    assert [check["update_every"] for check in model.metrics["weights"]["scored_again"]] == [5]
    bias = "actor.layers.0.bias"
    assert torch.equal(model.state_dict()[bias], tiny(1).state_dict()[bias].half().float())
    monkeypatch.setattr(export_module, "rescore", lambda model, name: [Check(1, 0.4, 0.9, 0.1, 0, 0)])
    with pytest.raises(ValueError, match=r"16 bits are too few for worse \(update every 1: 0\.400"):
        export("runs/actor", "worse", half=True)
    assert not Path("checkpoints/worse").exists()


@pytest.mark.slow
def test_verify_measures_the_scores_of_the_card_again(entry, capsys):
    assert cli.main(["zoo", "verify", str(entry)]) == 0
    (line,) = capsys.readouterr().out.splitlines()[-1:]
    (own,) = [row for row in tsjepa.load(entry).metrics["closed_loop"] if row["controller"] == "TS-JEPA"]
    score, failures = sum(own["per_seed"]) / 2, own["failures"]
    assert line == (
        f"{entry}: update every 5: {score:.3f} and {failures} failures, its card's figures for these starts are "
        f"{score:.3f} ± {own['interval_95']:.3f} and at most {failures}: as it says"
    )


@pytest.mark.slow
@pytest.mark.parametrize("change", [{"per_seed": [9.0, 9.0]}, {"per_seed": [float("nan")] * 2}])
def test_verify_fails_with_one_sentence_where_a_score_has_left_its_interval(entry, capsys, monkeypatch, change):
    model = tsjepa.load(entry)
    monkeypatch.setattr(entries, "json_text", lambda path, value, indent=None: json.dumps(value))  # NaN of a stranger's
    for row in model.metrics["closed_loop"]:
        row |= change
    entries.save(model, "checkpoints/altered", model.metrics)
    assert cli.main(["zoo", "verify", "checkpoints/altered"]) != 0
    output, complaint = capsys.readouterr()
    assert "NOT AS IT SAYS" in output
    assert complaint == "tsjepa zoo: Outside the interval of its card: checkpoints/altered; train or export it anew.\n"


def test_a_score_inside_its_interval_with_too_many_falls_is_refused():
    row = {"per_seed": [0.9] * 5, "failures": 22, "starts": 100}
    allowed = failures_allowed(row, 2)
    assert 9 <= allowed < 22  # 40 of the 100 starts are run again
    assert Check(5, 0.9, 0.9, 0.1, allowed, allowed).passed
    assert not Check(5, 0.9, 0.9, 0.1, allowed + 1, allowed).passed


def test_none_may_fall_where_none_fell_and_all_where_all_did():
    row = {"per_seed": [0.9] * 5, "starts": 100}
    assert failures_allowed(row | {"failures": 0}, 2) == 0
    assert failures_allowed(row | {"failures": 100}, 2) == 40


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda folder: (folder / entries.WEIGHTS).write_bytes(b""), "is not the file that the manifest names"),
        (lambda folder: (folder / entries.WEIGHTS).write_text(POINTER), "model.safetensors is a pointer of Git LFS"),
        (lambda folder: (folder / entries.MANIFEST).write_text(POINTER), "manifest.json is a pointer of Git LFS"),
        (lambda folder: (folder / entries.MANIFEST).unlink(), "manifest.json is missing"),
        (lambda folder: (folder / entries.MANIFEST).write_text("[]"), "manifest.json is unreadable"),
        (lambda folder: entries.save(tiny(), folder), "do not say how it scored"),
        (lambda folder: entries.save(tiny(), folder, {"closed_loop": []}), "do not say how it scored"),
    ],
)
def test_verify_fails_with_one_sentence_where_nothing_can_be_scored(tmp_path, capsys, damage, said):
    folder = entries.save(tiny(), tmp_path / "tiny")
    damage(folder)
    assert cli.main(["zoo", "verify", str(folder)]) != 0
    (complaint,) = capsys.readouterr().err.splitlines()
    assert complaint.startswith("tsjepa zoo: ")
    assert said in complaint


def test_arguments_by_place_are_as_many_as_there_are(capsys):
    with pytest.raises(SystemExit):
        cli.main(["zoo", "list", "tsjepa-cartpole", "more"])
    with pytest.raises(SystemExit):
        cli.main(["zoo", "improve"])
    first, second = capsys.readouterr().err.splitlines()
    assert "more" in first
    assert "improve" in second


def row(period: int, score: float, controller: str = "TS-JEPA") -> dict:
    return {
        "controller": controller,
        "update_every": period,
        "normalized_score": score,
        "interval_95": 0.0123,
        "failures": 2,
        "starts": 100,
        "command_nmae": 0.0087,
        "bits_per_step": 8192 / period,
    }


FIGURES = {
    "made_by": {"command": "tsjepa evaluate", "commit": "abc", "date": "2026-01-01"},
    "machine": {"processor": "a processor", "cores": 2},
    "optimal_policy": "reference LQR",
    "starts": "5 seeds x 20",
    "plant": {"class_path": "tsjepa.plants.CartPole", "init_args": {"process_noise_std": 0.008}},
    "open_loop": {"command_nmae": 0.0052},
    "closed_loop": [row(1, 1.0, "expert, perfect feedback"), row(1, 0.9876), row(5, 0.9), row(5, 0.1, "expert, zero")],
}


def test_the_list_shows_the_key_figures_of_every_entry(tmp_path, monkeypatch, capsys):
    once = row(1, 0.1) | {"update_every": "once", FIRST_LOST: 27}
    entries.save(tiny(), tmp_path / "tiny", FIGURES | {"closed_loop": [*FIGURES["closed_loop"], once]})
    entries.save(tiny_supervised(), tmp_path / "unmeasured")
    monkeypatch.setattr(entries, "zoo_folder", lambda: tmp_path)
    assert cli.main(["zoo"]) == 0
    printed = capsys.readouterr().out
    heading, rule, *lines = printed.splitlines()
    assert [cell.strip() for cell in heading.strip("|").split("|")] == list(HEADINGS)
    assert set(rule) == {"|", "-", " "}
    first, second = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    size = f"{sum(path.stat().st_size for path in (tmp_path / 'tiny').iterdir()) / 1e6:.1f}"
    assert first == ["tiny", "64", "0.988 ± 0.012, 2", "0.900 ± 0.012, 2", "-", "-", "0.0052", "27", size]
    assert second[:-1] == ["unmeasured", "64", *"------"]
    assert printed == table([key_figures("tiny"), key_figures("unmeasured")]) + "\n"
    assert cli.main(["zoo", "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)
    scores = [(row["update_every"], row["normalized_score"], row["failures"]) for row in first["closed_loop"]]
    assert scores == [(1, 0.9876, 2), (5, 0.9, 2)]
    assert (first["command_nmae"], first["sent_once"], first["bits_per_update_int8"]) == (0.0052, {FIRST_LOST: 27}, 64)
    assert second["closed_loop"] == [] and second["command_nmae"] is second["sent_once"] is None


def test_the_list_says_what_the_card_says():
    for name in entries.names():
        text, listed = tsjepa.load(name).card, key_figures(name)
        assert f"is {listed['command NMAE']}" in text
        shown = {cell.strip() for cell in text.split("|")}
        scores = [cell.rpartition(", ") for heading, cell in listed.items() if heading.startswith("every")]
        assert len(scores) == 4
        for score, _, failures in scores:
            if failures == "-":
                continue  # at that period it was not run
            assert score in shown
            assert f"{failures} of 100" in shown


def rows_below(heading: str, page: str) -> dict[str, list[str]]:
    """The cells of a page's tables that begin with ``heading``, by the entry that the row names."""
    rows: dict[str, list[str]] = {}
    for block in page.split("\n\n"):
        if block.startswith(heading):
            for line in block.splitlines()[2:]:
                name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
                rows[name.strip("`")] = cells
    return rows


def test_the_page_of_measured_entries_says_what_the_list_says():
    page = (Path(__file__).parents[2] / "docs" / "results" / "zoo.md").read_text()
    known = entries.names()
    assert rows_below("| entry | bit per", page) == {name: list(key_figures(name).values())[1:-1] for name in known}
    of_seeds = {name: list(row.values())[1:] for name in known if (row := seed_figures(name)) is not None}
    assert rows_below("| entry | training seeds", page) == of_seeds


def test_a_card_says_what_the_figures_say():
    text = card("tiny", tiny(), FIGURES)
    assert text.startswith("---\nlicense: apache-2.0\n")
    assert yaml.safe_load(text.split("---\n")[1])["tags"] == ["control", "cart-pole", "jepa"]
    lines = text.splitlines()
    assert "| 1 | 0.988 ± 0.012 | 2 of 100 | 0.0087 | 8192 |" in lines
    assert "| 5 | 0.900 ± 0.012 | 2 of 100 | 0.0087 | 1638 |" in lines
    assert not any(line.startswith("| 5 | 0.1") for line in lines)
    assert "Made by `tsjepa evaluate` at commit abc, 2026-01-01 on 2 cores of a processor." in lines
    assert 'model = tsjepa.load("tiny")' in lines
    assert "u = model.act(z)  # [..., m]: force (N)" in lines
    assert not any("correct" in line for line in lines)
    remembering = tiny()
    remembering.observer = Observer(remembering.embedding_dim)
    told = card("tiny", remembering, FIGURES)
    assert "z = model.correct(z, u, model.encode(next_frames))" in told.splitlines() and "The device remembers" in told
    remembering.observer = Observer(remembering.embedding_dim, hidden_dim=8, memory=False)
    assert "The device knows its last command" in card("tiny", remembering, FIGURES)
    assert "for the cart-pole, at 20 ms a slot" in text
    assert "(2 frames of 64 x 128, 20 ms apart)" in text
    assert "The scores hold for `tsjepa.plants.CartPole(process_noise_std=0.008)`." in text
    assert "On recorded test trajectories the command NMAE, to the expert's, is 0.0052." in lines
    assert "Sent once" not in text
    watched = {"state": "theta", "limit": 0.05, "unit": "rad"}
    for slot, said in ((23, "first in slot 23"), (None, "in no slot")):
        once = row(1, 0.5) | {"update_every": "once", FIRST_LOST: slot, "watched": watched}
        told = card("tiny", tiny(), FIGURES | {"closed_loop": [once]})
        assert f"Sent once, the mean error of the probed theta passes 0.05 rad {said}." in told
    drawn = card("tiny", tiny(), FIGURES | {"camera": {"gl_renderer": "softpipe"}})
    assert "a processor, pictures drawn by softpipe." in drawn


def test_a_card_names_the_set_points_of_a_model_that_takes_some():
    text = card("tiny", tiny(set_points=1), FIGURES)
    assert "u = model.act(z, reference)  # [..., m]: force (N); reference [..., r]: x (m)" in text.splitlines()


def test_a_card_of_a_recordings_model_names_no_plant():
    model = tiny()
    model.plant = None
    measured = {"command_nmae": 0.1, "command_nmae_to": "action", "skill_over_copying": {"1": 0.9, "5": 0.75}}
    text = card("tiny", model, {"open_loop": measured})
    assert (
        "On recorded test trajectories the command NMAE, to the recorded commands, is 0.1000; the prediction skill "
        "over copying after 1, 5 slots is 0.900, 0.750." in text.splitlines()
    )
    assert yaml.safe_load(text.split("---\n")[1])["tags"] == ["control", "recording", "jepa"]
    assert "tsjepa.plants" not in text


def test_a_card_of_a_model_that_nobody_has_measured_claims_nothing():
    text = card("tiny", tiny(), {})
    assert "## Figures" not in text
    assert "## Training" not in text
    assert "## Use and limits" in text


def test_a_card_of_a_controller_without_predictor_does_not_promise_one():
    text = card("tiny", tiny_supervised(), FIGURES)
    assert yaml.safe_load(text.split("---\n")[1])["tags"][-1] == "imitation-learning"
    assert "model.predict" not in text
    assert "the last command is held" in text
