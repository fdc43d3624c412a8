"""``tsjepa zoo train``: every entry has its commands, a second start goes on, and a tiny one is made whole."""

import itertools
import json
import os
import shlex
import time
from pathlib import Path

import pytest
import tiny
import tiny_controller
import torch

import tsjepa
from tsjepa import cli
from tsjepa.models import entries
from tsjepa.support.files import write_json
from tsjepa.zoo import train as train_module
from tsjepa.zoo.steps import ENTRIES, evaluation, fits, run_of
from tsjepa.zoo.train import train

NAME = "tsjepa-cartpole-d16"


def test_every_shipped_entry_has_a_recipe():
    assert set(entries.names()) <= set(ENTRIES)


@pytest.mark.parametrize("name", ENTRIES)
def test_the_commands_of_an_entry_follow_from_each_other(name):
    steps = fits(ENTRIES[name], "runs/zoo/x/seed3", 3)
    base = ENTRIES[name].after
    made = [f"runs/zoo/{base}/seed3/{ENTRIES[base].fits[-1].recipe}/model"] if base else []
    for words in steps.values():
        options = dict(zip(words[1::2], words[2::2], strict=True))
        assert words[0] == "fit" and options["--seed_everything"] == "3"
        # the first starts from nothing or from another entry, the next from the model that the one before has left
        assert options.get("--model.init_args.pretrained") == (made[-1] if made else None)
        made.append(options["--trainer.default_root_dir"] + "/model")
    assert made[-1] == run_of(ENTRIES[name], "runs/zoo/x/seed3") + "/model"
    evaluate = evaluation(ENTRIES[name], "runs/zoo/x/seed3", "runs/zoo/y")
    assert evaluate[evaluate.index("--model") + 1] == made[-1]
    for words in (*steps.values(), evaluate):
        named = [word for flag, word in itertools.pairwise(words) if flag == "--config"]
        assert all((tiny.ROOT / recipe).is_file() for recipe in named)


def encoders(recipe: dict) -> list[dict]:
    return (
        [recipe["model"]["init_args"]["encoder"]] if "encoder" in recipe.get("model", {}).get("init_args", {}) else []
    )


@pytest.mark.parametrize("name", [name for name in tiny.NAMES if name.endswith("jepa.yaml") or "zoo/" in name])
def test_a_recipe_over_another_says_whether_its_encoder_has_convolutions(name):
    # a class that is named anew takes the arguments along that it knows, here the widths of the recipe beneath
    for encoder in encoders(tiny.load(name)):
        assert not encoder["class_path"].endswith("DifferenceEncoder") or "widths" in encoder["init_args"]


def test_an_entry_or_a_number_of_seeds_that_cannot_be_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="no recipe for 'absent': choose one of tsjepa-cartpole"):
        train("absent")
    with pytest.raises(ValueError, match=r"no recipe for 'tsjepa-cartpole-d15' - did you mean tsjepa-cartpole-d\d+\?$"):
        train("tsjepa-cartpole-d15")
    with pytest.raises(ValueError, match="seeds is 0"):
        train(NAME, 0)
    assert not list(tmp_path.iterdir())


class Program:
    """In place of the commands' processes: notes each, leaves what it would leave, and fails at the one ``refused``."""

    def __init__(self, refused: str = "nothing") -> None:
        self.refused, self.ran = refused, []

    def __call__(self, words):
        options = dict(itertools.pairwise(words))
        self.ran.append((words[0], options))
        folder = options.get("--trainer.default_root_dir", options.get("--output"))
        if words[0] == "fit":
            Path(ENTRIES[NAME].data).mkdir(parents=True, exist_ok=True)
            (Path(folder) / "checkpoints").mkdir(parents=True, exist_ok=True)
            (Path(folder) / "checkpoints" / "last.ckpt").touch()
        if folder and folder.endswith(self.refused):
            raise RuntimeError(self.refused)
        if words[0] == "fit":
            entries.save(tiny_controller.tiny(int(options["--seed_everything"])), f"{folder}/model")
        if words[0] == "evaluate":
            seed = int(options["--first_seed"]) if "--first_seed" in options else 0
            Path(folder).mkdir(exist_ok=True)
            write_json(Path(folder, "evaluation.json"), evaluated(0.9, seed))
        return 7.0


def evaluated(score: float, first_seed: int = 1000) -> dict:
    """An evaluation on two sets of starts."""
    common = {"controller": "TS-JEPA", "failures": 1, "starts": 40, "command_nmae": 0.01}
    rows = [common | {"update_every": 5, "per_seed": [score - 0.1, score + 0.1]}]
    starts = {"starts": "2 seeds x 20", "seeds": [first_seed, first_seed + 1], "slots": 100}
    return starts | {"optimal_policy": "an LQR", "closed_loop": rows, "open_loop": {"command_nmae": 0.01}}


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Starts the training with a program in place of the commands; gives those that it was told, with their options."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train_module, "listed", lambda names: print(f"{len(names)} rows"))
    errors = iter((0.3, 0.1, 0.2))
    monkeypatch.setattr(train_module, "validation_error", lambda folder, data, split: next(errors))

    def start(refused: str = "nothing", seeds: int = 1, name: str = NAME) -> list[tuple[str, dict]]:
        program = Program(refused)
        monkeypatch.setattr(train_module, "run", program)
        if refused == "nothing":
            train(name, seeds)
        else:
            with pytest.raises(RuntimeError, match=refused):
                train(name, seeds)
        return program.ran

    return start


def test_a_second_start_goes_on_where_the_first_was_broken_off(program, capsys):
    program("seed0/actor")
    ran = program()
    assert [command for command, _ in ran] == ["fit", "evaluate", "export"]
    assert ran[0][1]["--ckpt_path"] == "last" and "--ckpt_path" not in ran[1][1]
    said = ran[2][1]["--trained_with"]
    assert f"Made by `tsjepa zoo train {NAME}`" in said
    assert "jepa 7 s with collecting the data, actor 7 s; evaluate 7 s, on " in said
    assert "--training_seeds" not in ran[2][1]
    printed = capsys.readouterr().out
    assert f"runs/zoo/{NAME}/seed0, jepa: done before, in 7 s" in printed
    assert f"To ship it: cp -r runs/zoo/{NAME}/entry/{NAME} " in printed
    assert program() == []


HOME = Path("runs/zoo", NAME)
EDIT = "edited: true\n"
REFUSED = "seed0 was made by other recipes, commands or versions than there are: move it away and start again"


@pytest.fixture
def recipes(tmp_path):
    """The recipes, to be edited, below the working directory."""
    for name in tiny.NAMES:
        tiny.write(tmp_path, name, tiny.load(name))
    return tmp_path / "recipes"


# of the first fit, over it, of its data, and of the second fit
@pytest.mark.parametrize("edited", ["jepa", "zoo/d16", "zoo/data", "actor"])
@pytest.mark.parametrize("reached", ["seed0/jepa", "seed0/actor", "nothing"])
def test_what_other_recipes_have_made_is_neither_continued_nor_shipped(program, recipes, edited, reached):
    program(reached)
    before = {path: path.read_bytes() for path in HOME.rglob("*") if path.is_file()}
    kept = (recipes / f"{edited}.yaml").read_text()
    (recipes / f"{edited}.yaml").write_text(kept + EDIT)
    with pytest.raises(ValueError, match=REFUSED):
        train(NAME)
    assert {path: path.read_bytes() for path in HOME.rglob("*") if path.is_file()} == before
    (recipes / f"{edited}.yaml").write_text(kept)
    again = program()
    assert [command for command, _ in again] == {
        "seed0/jepa": ["fit", "fit", "evaluate", "export"], "seed0/actor": ["fit", "evaluate", "export"], "nothing": []
    }[reached]  # fmt: skip
    assert reached == "nothing" or again[0][1]["--ckpt_path"] == "last"
    (recipes / f"{edited}.yaml").write_text(kept + EDIT)
    (HOME / "seed0").rename(HOME / "away")
    assert all("--ckpt_path" not in options for _, options in program())


def test_recipes_that_no_command_of_the_entry_names_may_be_edited(program, recipes):
    program()
    (recipes / "autoencoder.yaml").write_text("{}")
    assert program() == []


def test_the_comments_of_a_recipe_may_be_edited(program, recipes):
    program()
    for path in recipes.rglob("*.yaml"):
        path.write_text(f"# recipes/none.yaml\n{path.read_text()}# edited\n")
    assert program() == []


def test_an_evaluation_by_another_recipe_is_made_anew(program, recipes):
    program()
    with (recipes / "evaluate.yaml").open("a") as file:
        file.write(EDIT)
    assert [command for command, _ in program()] == ["evaluate", "export"]


def without_hashes(journal: Path) -> None:
    settings, *done = journal.read_text().splitlines()
    journal.write_text("\n".join([json.dumps(json.loads(settings)["commands"]), *done, ""]))


@pytest.mark.parametrize(
    "change", [without_hashes, Path.unlink, lambda journal: journal.write_text('{"commands": {"jepa"')]
)
def test_fits_whose_recipes_nobody_knows_are_left_as_they_are(program, change):
    program("seed0/actor")
    change(HOME / "seed0" / "steps.journal")
    before = {path: path.read_bytes() for path in HOME.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=REFUSED):
        train(NAME)
    assert {path: path.read_bytes() for path in HOME.rglob("*") if path.is_file()} == before


def test_of_several_training_seeds_the_best_by_validation_is_shipped_and_all_meet_fresh_starts(program):
    home = f"runs/zoo/{NAME}"
    assert [options["--seed_everything"] for command, options in program() if command == "fit"] == ["0", "0"]
    ran = program("seed2/actor", 3)  # what the first start has made stays
    assert [options["--seed_everything"] for _, options in ran] == ["1", "1", "2", "2"]
    ran = program("seed1/fresh", 3)
    assert [command for command, _ in ran] == ["fit", "evaluate", "evaluate", "evaluate"]
    assert ran[1][1]["--model"] == f"{home}/seed1/actor/model" and "--first_seed" not in ran[1][1]
    *fresh, (command, exported) = [*ran[2:3], *program(seeds=3)]
    assert [options["--model"] for _, options in fresh] == [f"{home}/seed{seed}/actor/model" for seed in range(3)]
    assert {options["--first_seed"] for _, options in fresh} == {"1000"}
    assert command == "export" and exported["export"] == f"{home}/seed1/actor"
    assert f"`tsjepa zoo train {NAME} --seeds 3`" in exported["--trained_with"]
    assert "; seed 2: jepa 7 s, actor 7 s; evaluate 7 s, evaluate seed 0 7 s" in exported["--trained_with"]
    of_seeds = json.loads(Path(exported["--training_seeds"]).read_text())
    assert (of_seeds["shipped"], of_seeds["validation"]["command_nmae"]) == (1, [0.3, 0.1, 0.2])
    assert program(seeds=3) == []


def test_other_weights_are_evaluated_and_exported_anew(program):
    program()
    entries.save(tiny_controller.tiny(9), f"runs/zoo/{NAME}/seed0/actor/model")
    assert [command for command, _ in program()] == ["evaluate", "export"]


def test_an_entry_after_another_one_has_that_ones_fits_made_first(program):
    ran = program(name=f"{NAME}-observer")
    fits = [options["--trainer.default_root_dir"] for command, options in ran if command == "fit"]
    assert fits == [
        f"runs/zoo/{NAME}/seed0/jepa",
        f"runs/zoo/{NAME}/seed0/actor",
        f"runs/zoo/{NAME}-observer/seed0/observer",
    ]
    command, exported = ran[-1]
    assert command == "export" and exported["export"] == f"runs/zoo/{NAME}-observer/seed0/observer"
    assert exported["--decoder"] == "false"  # the other entry has the same one
    collected = "observer 7 s with collecting the data"
    assert f"jepa 7 s with collecting the data, actor 7 s, {collected}; evaluate 7 s, on" in exported["--trained_with"]
    ran = program()
    assert [command for command, _ in ran] == ["evaluate", "export"] and "--decoder" not in ran[-1][1]
    assert program(name=f"{NAME}-observer") == []
    entries.save(tiny_controller.tiny(9), f"runs/zoo/{NAME}/seed0/actor/model")
    with pytest.raises(ValueError, match=f"observer has started from another {NAME} than there is: move"):
        program(name=f"{NAME}-observer")


def in_this_process(words: list[str]) -> float:
    """Runs a command as :func:`tsjepa.zoo.child.run` does, whose process is tested in tests/zoo/test_child.py."""
    began = time.monotonic()
    print(f"tsjepa {shlex.join(words)}")
    assert cli.main(words) == 0
    return time.monotonic() - began


@pytest.mark.slow
def test_one_command_makes_an_entry_with_its_card(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(train_module, "run", in_this_process)
    for name in tiny.NAMES:
        shorter = {"slots": 40, "video": False} if name == "recipes/evaluate.yaml" else {}
        tiny.write(tmp_path, name, tiny.shrink(tiny.load(name)) | shorter)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["zoo", "train", NAME, "--seeds", "2"]) == 0
    folder = Path(f"runs/zoo/{NAME}/entry/{NAME}")
    model = tsjepa.load(str(folder))
    assert model.embedding_dim == 16 and model.encoder.widths is None  # the recipe beneath has widths
    assert f"Made by `tsjepa zoo train {NAME} --seeds 2`" in (folder / "README.md").read_text()
    figures = json.loads((folder / "metrics.json").read_text())
    assert figures["seeds"] == [0, 1] and figures["training_seeds"]["start_seeds"] == [1000, 1001]
    shipped = figures["training_seeds"]["shipped"]
    assert {fit["seed"] for fit in figures["training"]} == {shipped}
    errors = figures["training_seeds"]["validation"]["command_nmae"]
    assert errors[shipped] == min(errors)
    weights = [entries.load(f"runs/zoo/{NAME}/seed{seed}/actor/model").state_dict() for seed in range(2)]
    assert not torch.equal(*(each["actor.layers.0.weight"] for each in weights))
    assert torch.equal(model.state_dict()["actor.layers.0.weight"], weights[shipped]["actor.layers.0.weight"].half())
    assert [Path(fit["data"]).name for fit in figures["training"]] == ["cartpole-large"] * 2
    printed = capfd.readouterr().out
    assert (
        "tsjepa fit --config recipes/jepa.yaml" in printed and f"cores of {figures['machine']['processor']}" in printed
    )
    before = {path: os.stat(path).st_mtime_ns for path in folder.iterdir()}
    assert cli.main(["zoo", "train", NAME, "--seeds", "2"]) == 0
    assert before == {path: os.stat(path).st_mtime_ns for path in folder.iterdir()}
