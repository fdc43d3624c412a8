"""The command line: help, exit statuses, and what is said when something is wrong."""

import importlib.metadata
import json
import re
import shlex
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import jsonargparse
import pytest
import tiny
import tiny_controller
import tiny_data
import yaml

from tsjepa import cli
from tsjepa.cli import command_line, doctor
from tsjepa.cli.afterwards import STEPS, next_step
from tsjepa.cli.errors import explain
from tsjepa.data import storage
from tsjepa.envs import Radio
from tsjepa.models import entries
from tsjepa.plants import CartPole, Pendulum, Reacher
from tsjepa.support import recipes
from tsjepa.support.gl import missing_backend_message
from tsjepa.support.recipes import one_sentence
from tsjepa.support.workers import run_items

ALL_COMMANDS = [*cli.LIGHTNING_COMMANDS, *cli.COMMANDS]


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of one command."""
    try:
        status = cli.main(arguments)
    except SystemExit as exit_:
        status = exit_.code
    return status, *capsys.readouterr()


def test_ctrl_c_ends_a_command_with_the_status_of_a_shell_and_without_a_traceback(capsys, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command_line, "_answer", stopped)
    assert run(capsys, "zoo") == (130, "", "")


def test_help_lists_every_command_without_importing_anything_heavy():
    code = (
        "import sys; from tsjepa.cli import main; main(['--help']); "
        "print('heavy:', *(name for name in ('torch', 'lightning', 'mujoco', 'jsonargparse') if name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert all(command in done.stdout for command in ALL_COMMANDS)
    assert done.stdout.splitlines()[-1].strip() == "heavy:"


@pytest.mark.parametrize("command", ALL_COMMANDS)
def test_every_command_has_help(capsys, command):
    status, output, _ = run(capsys, command, "--help")
    assert status == 0
    assert output.startswith("usage: tsjepa")
    assert "--config" in output
    assert command in cli.LIGHTNING_COMMANDS or not re.search(r":\w+:`", output)  # no roles of reStructuredText


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["evalute"], "there is no command 'evalute' - did you mean evaluate?"),
        (["xyzzy"], "there is no command 'xyzzy' (commands: tsjepa --help)"),
        (["doctor", "--frames", "many"], "frames"),
        (["doctor", "--frmes", "3"], "unrecognized arguments: --frmes 3 - did you mean frames?"),
        (["doctor", "--frame", "3"], "unrecognized arguments: --frame 3 - did you mean frames?"),
        (["fit", "--model", "tsjepa.training.jepa.TSJEPA", "--ckpt", "last"], "--ckpt"),
        (["doctor", "--xyzzy", "3"], "unrecognized arguments: --xyzzy 3 (options: tsjepa doctor --help)"),
        (["fit", "--modl", "x"], "did you mean model?"),
        (["collect", "--plant", "CartPole", "--plant.sampling_intervall", "1"], "did you mean sampling_interval?"),
        (["collect", "--config", "absent.yaml"], "absent.yaml"),
        (["fit", "--config", "absent.yaml"], "absent.yaml"),
        (["fit", "--trainer.max_epochs", "many"], "trainer.max_epochs"),
        (["fit", "--model", "tsjepa.training.Absent"], "Absent"),
        (["simulate", "--schedulers=a,b"], "'schedulers': Expected a list, written \"[a, b]\". Got value: a,b"),
        (["simulate", "--radio.priority=2"], "'radio.priority': Expected a list, written \"[a, b]\"; Given value: 2"),
        (["simulate", "--radio.snr_target_db=a"], 'Expected float; Expected a list, written "[a, b]"; Given value: a'),
        (["import", "x", "--size=64"], "'size': Expected a list, written \"[a, b]\"; Given value: 64"),
        (["import", "x", "--size=[64]"], "'size': Expected a list of 2 elements; Given value: [64]"),
        (["collect", "--plant=CartPole", "--plant.start_half_widths=1,2"], 'Expected a list, written "[a, b]". Got'),
        (["collect", "--plant=CartPol"], "no class CartPol is known, give its import path, package.module.CartPol"),
        (["simulate", "--radio.loss=tsjepa.plants.CartPole"], "tsjepa.plants.CartPole is not IidLoss;"),
        (["zoo", "verfy"], "'action': Expected one of 'list', 'verify', 'train'. Got value: verfy"),
        (["evaluate", "tsjepa-cartpole-d15"], "no model 'tsjepa-cartpole-d15' - did you mean tsjepa-cartpole-d1"),
    ],
)
def test_wrong_arguments_are_answered_in_one_line_and_status_2(capsys, arguments, named):
    status, output, complaint = run(capsys, *arguments)
    assert status == 2
    assert output == ""
    assert named in complaint
    assert len(complaint.splitlines()) == 1


def test_without_a_command_three_are_named_that_parse(capsys):
    status, output, complaint = run(capsys)
    assert status == 0 and complaint == ""
    steps = re.findall(r"^  tsjepa (\S.*?)  ", output, flags=re.MULTILINE)
    assert len(steps) == 3
    for step in steps:
        assert run(capsys, *step.split(), "--print_config")[0] == 0, step


def test_a_key_of_a_recipe_is_suggested_too(capsys, tmp_path):
    for command, text, meant in (
        ("simulate", "controler: hold", "controller"),
        ("fit", "trainer: {max_epoch: 3}", "trainer.max_epochs"),
    ):
        (tmp_path / "recipe.yaml").write_text(text)
        status, _, complaint = run(capsys, command, "--config", str(tmp_path / "recipe.yaml"))
        assert status == 2
        assert f"did you mean {meant}?" in complaint


def test_json_is_all_that_stands_on_standard_output(capsys):
    status, output, complaint = run(capsys, "zoo", "--json")
    assert status == 0
    assert "tsjepa-cartpole" in {entry["entry"] for entry in json.loads(output)}
    assert "| tsjepa-cartpole " in complaint


@pytest.mark.parametrize(
    ("command", "values", "result"),
    [
        ("evaluate", {"model": "tsjepa-cartpole"}, {"closed_loop": []}),
        ("evaluate", {"model": "tsjepa-cartpole"}, {"open_loop": {"command_nmae": 0.1}}),
        ("export", {}, {"entry": "checkpoints/mine"}),
        ("figures", {}, [{"figure": "bits", "points": 3}]),
    ],
)
def test_what_to_do_next_is_a_command_that_parses(capsys, command, values, result):
    said = next_step(command, values, result)
    assert run(capsys, *words_of(said), "--print_config")[0] == 0, said


def words_of(said: str) -> list[str]:
    return shlex.split(said.partition(": tsjepa ")[2])


@pytest.mark.parametrize("plant", ["recorded", None])
def test_after_the_actor_its_model_is_evaluated(capsys, tmp_path, plant):
    data = tiny_data.write(tmp_path / "data")
    if plant is None:
        metadata = json.loads((data / storage.METADATA).read_text())
        (data / storage.METADATA).write_text(json.dumps(metadata | {"plant": None}))
    said = next_step("fit", {}, {"acts": True, "model": "runs/actor/model", "data": str(data)})
    assert run(capsys, *words_of(said), "--print_config")[0] == 0, said
    assert ("loop" in said) == (plant is not None)  # a recording has none that could be closed


def test_the_search_after_a_fleet_keeps_all_that_its_command_said(capsys, tmp_path):
    options = ["--num_devices", "6", "--schedulers", "[max_age, random]", "--radio.resource_blocks", "2"]
    options += ["--slots", "7", "--record", str(tmp_path / "fleet.rrd"), "--plant", "tsjepa.plants.Pendulum"]
    values = {"num_devices": 6, "radio": Radio(resource_blocks=2), "output": "runs/six", "record": "fleet.rrd"}
    words = words_of(next_step("simulate", values, {"fleet": {}}, options))
    status, shown, _ = run(capsys, *words, "--print_config")
    found = yaml.safe_load(shown)
    assert status == 0
    assert (found["num_devices"], found["search_over"], found["record"]) == (None, [2, 3, 6, 12, 24], None)
    assert (found["schedulers"], found["radio"]["resource_blocks"]) == (["max_age", "random"], 2)
    assert (found["slots"], found["output"]) == (7, "runs/six-search")
    assert found["plant"]["class_path"].endswith("Pendulum")
    assert next_step("simulate", values, {"search": {}}, words[1:]) is None


@pytest.mark.slow
@pytest.mark.parametrize("splits", [{"train": 4, "test": 2, "validation": 2}, {"train": 4}])
def test_the_actor_after_a_fit_on_a_recording_learns_on_what_it_has(tmp_path, monkeypatch, splits):
    tiny.write(tmp_path, "recipes/actor.yaml", tiny.shrink(tiny.load("recipes/actor.yaml")))
    monkeypatch.chdir(tmp_path)
    result = {"acts": False, "data": str(tiny_data.write(Path("data"), slots=70, **splits))}
    result["model"] = str(entries.save(tiny_controller.tiny(), "runs/mine-jepa/model"))
    assert cli.main(words_of(next_step("fit", {}, result))) == 0
    # beside the main job's actor, with what the finishes found
    assert entries.load("runs/mine-actor/model").code_low.isfinite().all()


def test_the_actor_after_a_fit_on_the_recipes_data_is_the_recipes(tmp_path):
    folder = tiny_data.write(tmp_path / "data")
    said = next_step("fit", {}, {"acts": False, "data": str(folder), "model": "runs/jepa/model"})
    assert said.endswith(f"--model.init_args.pretrained runs/jepa/model --data.init_args.path {folder}")


@pytest.mark.parametrize("command", ["collect", "import"])
@pytest.mark.parametrize(
    ("plant", "needed"),
    [
        (CartPole(), {}),
        (Pendulum(), {"encoder.init_args.height": "64", "encoder.init_args.width": "64"}),
        (
            Reacher(),
            {"encoder.init_args.height": "64", "encoder.init_args.width": "64", "predictor.init_args.action_dim": "2"},
        ),
    ],
)
def test_the_fit_after_a_data_set_has_its_sizes(capsys, tmp_path, command, plant, needed):
    metadata = {"format": storage.FORMAT, "files": {}, "spec": plant.spec.to_dict(), "splits": {"train": {}}}
    (tmp_path / storage.METADATA).write_text(json.dumps(metadata))
    words = words_of(next_step(command, {}, tmp_path))
    prefix = "--model.init_args."
    assert {name.removeprefix(prefix): size for name, size in pairwise(words) if name.startswith(prefix)} == needed
    assert words[-4:-2] == ["--trainer.limit_val_batches", "0"]  # without a split to validate on
    assert words[-2:] == ["--trainer.default_root_dir", f"runs/jepa-{tmp_path.name}"]  # not over the main job's model
    assert run(capsys, *words, "--print_config")[0] == 0


@pytest.mark.parametrize(("frame", "named"), [((40, 96), "DifferenceEncoder"), ((50, 70), "--size")])
def test_pictures_that_the_recipes_encoder_refuses_get_another_one_or_another_size(capsys, tmp_path, frame, named):
    spec = CartPole().spec.to_dict() | {"frame": list(frame)}
    metadata = {"format": storage.FORMAT, "files": {}, "spec": spec, "splits": {"train": {}, "validation": {}}}
    (tmp_path / storage.METADATA).write_text(json.dumps(metadata))
    words = words_of(next_step("import", {"size": list(frame)}, tmp_path, ["films", "data/films"]))
    status, shown, _ = run(capsys, *words, "--print_config")
    assert status == 0
    found = yaml.safe_load(shown)
    if named == "--size":
        assert (found["size"], words[0]) == ([64, 64], "import")  # the nearest multiples of 32
    else:
        encoder = found["model"]["init_args"]["encoder"]
        assert encoder["class_path"].endswith(named)
        assert (encoder["init_args"]["height"], encoder["init_args"]["width"]) == frame


def test_what_to_do_next_covers_every_case_above_and_no_other():
    assert set(STEPS) == {"fit", "collect", "import", "evaluate", "simulate", "export", "figures"}
    assert next_step("doctor", {}, {"mend": []}) is None
    assert next_step("fit", {}, {}) is None  # another process of a parallel fit


def test_bash_completes_commands_and_options(capsys):
    status, script, _ = run(capsys, "completion", "bash")
    assert status == 0

    def completed(*words: str) -> set[str]:
        line = " ".join(shlex.quote(word) for word in ("tsjepa", *words))
        program = f"{script}\nCOMP_WORDS=({line}); COMP_CWORD={len(words)}; _tsjepa; echo ${{COMPREPLY[@]}}"
        return set(subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=True).stdout.split())

    assert completed("ev") == {"evaluate"}
    assert completed("") == set(ALL_COMMANDS)
    assert completed("simulate", "--radio.reso") == {"--radio.resource_blocks"}
    assert {"--trainer.max_epochs", "--ckpt_path"} <= completed("fit", "--")
    assert completed("evaluate", "runs/") == set()  # left to the shell, which completes files


def test_fish_completes_the_same(capsys):
    _, script, _ = run(capsys, "completion", "fish")
    lines = script.splitlines()
    assert any("-a evaluate -d" in line for line in lines)
    assert "complete -c tsjepa -n '__fish_seen_subcommand_from simulate' -l radio.resource_blocks" in lines


def test_what_the_program_refuses_is_said_without_a_traceback(capsys):
    status, _, complaint = run(capsys, "doctor", "--frames", "0")
    assert status == 2
    assert complaint.startswith("tsjepa doctor: frames is 0")
    assert len(complaint.splitlines()) == 1


OWN = """from tsjepa.plants import CartPole

class Stick(CartPole):
    def __init__(self, length: float = 1.0):
        super().__init__()
        {}["length"]

class Long(CartPole):
    def __init__(self, length: float):
        super().__init__()
"""


@pytest.mark.parametrize(
    ("plant", "said"),
    [
        ("own_plant.Stik", "Stik cannot be imported: own_plant has no 'Stik' - did you mean Stick?"),
        ("own_plnt.Stick", "No module named 'own_plnt'; run from the folder of your file with PYTHONPATH=. before"),
        ("own_broken.Stick", "own_broken.py, line 2: ZeroDivisionError: division by zero"),
        ("own_lacking.Stick", "own_lacking.py, line 1: ModuleNotFoundError: No module named 'no_such_package'"),
        ("own_plant.Stick", "own_plant.py, line 6: KeyError: length"),
        ("own_plant.Long", "'own_plant.Long': the following arguments are required: length (options"),
    ],
)
def test_code_of_the_users_own_that_cannot_be_used_is_named_in_one_line(capsys, tmp_path, monkeypatch, plant, said):
    (tmp_path / "own_plant.py").write_text(OWN)
    (tmp_path / "own_broken.py").write_text("\n1 / 0")
    (tmp_path / "own_lacking.py").write_text("import no_such_package")
    monkeypatch.syspath_prepend(tmp_path)
    # this process may have forbidden classes of others
    monkeypatch.setitem(jsonargparse._common.parsing_settings, "import_path_verdicts", {})
    data = ["--path", str(tmp_path / "data"), "--splits", "{train: {episodes: 1}}"]
    status, _, complaint = run(capsys, "collect", *data, "--plant", plant, "--trust")
    assert status != 0
    assert said in complaint
    assert len(complaint.splitlines()) == 1
    assert not (tmp_path / "data").exists()


@pytest.mark.slow
def test_what_a_worker_process_refuses_is_said_as_well():
    with pytest.raises(ValueError) as refused:
        list(run_items(entries.verify, [tiny.ROOT / "recipes"] * 2, workers=2))
    assert explain(refused.value) == f"{tiny.ROOT / 'recipes' / entries.MANIFEST} is missing; fetch the entry anew."


def test_traceback_on_demand(monkeypatch):
    monkeypatch.setenv("TSJEPA_TRACEBACK", "1")
    with pytest.raises(ValueError, match="frames is 0"):
        cli.main(["doctor", "--frames", "0"])


def test_unforeseen_exceptions_keep_their_traceback(monkeypatch):
    def broken() -> None:
        raise ValueError("not raised by the package")

    monkeypatch.setattr(doctor, "doctor", broken)
    with pytest.raises(ValueError, match="not raised by the package"):
        cli.main(["doctor"])


def test_missing_package_is_named(monkeypatch, capsys):
    def needs_more() -> None:
        import a_package_that_nobody_has  # noqa: F401

    monkeypatch.setattr(doctor, "doctor", needs_more)
    status, _, complaint = run(capsys, "doctor")
    assert status == 1
    assert "a_package_that_nobody_has is not installed" in complaint


def test_value_error_of_a_call_is_not_taken_for_a_refusal():
    try:
        doctor.re.compile("(")
    except Exception as error:
        assert explain(error) is None


def test_messages_of_jsonargparse_are_distilled():
    message = """Parser key "trainer.max_epochs":
  Does not validate against any of the Union subtypes
  Subtypes: [<class 'int'>, <class 'NoneType'>]
  Errors:
    - Expected a <class 'int'>
    - Expected a <class 'NoneType'>
  Given value type: <class 'str'>
  Given value: abc"""
    assert one_sentence(message) == "option 'trainer.max_epochs': Expected a int; Given value: abc"
    message = """Parser key "trainer.callbacks":
  Does not validate against any of the Union subtypes
  Errors:
    - Expected a path but own.Loud either not accessible or invalid
    - Problem with given class_path 'own.Loud':
        the following arguments are required: word
    - Not a valid subclass of Callback
      Subclass types expect one of:
      - a class path (str)
      - a dict with class_path entry
  Given value: [Namespace(class_path='own.Loud')]"""
    said = "Problem with given class_path 'own.Loud': the following arguments are required: word"
    assert one_sentence(message) == f"option 'trainer.callbacks': {said}"


def test_shipped_recipes_are_found_from_anywhere(monkeypatch, tmp_path):
    shipped = tmp_path / "installed"
    (shipped / "recipes").mkdir(parents=True)
    (shipped / "recipes" / "jepa.yaml").touch()
    monkeypatch.setattr(recipes, "PACKAGE", shipped)
    monkeypatch.chdir(tmp_path)
    found, absent = str(shipped / "recipes" / "jepa.yaml"), "recipes/absent.yaml"
    assert recipes.find_recipes(["--config", "recipes/jepa.yaml", absent]) == ["--config", found, absent]
    (tmp_path / "recipes").mkdir()
    (tmp_path / "recipes" / "jepa.yaml").touch()
    assert recipes.find_recipes(["recipes/jepa.yaml"]) == ["recipes/jepa.yaml"]


@pytest.mark.slow
@pytest.mark.parametrize("part", ["model", "data"])
def test_a_recipe_that_lies_over_another_is_not_taken_for_a_whole_one(capsys, tmp_path, part):
    (tmp_path / "over.yaml").write_text(f"{part}: {{init_args: {{embedding_dim: 16}}}}")
    status, _, complaint = run(capsys, "fit", "--config", str(tmp_path / "over.yaml"))
    assert status == 2
    assert f"no class of the {part}, as one that lies over another: give that one before it" in complaint


@pytest.mark.parametrize("load", [0.1, 1.7])
def test_doctor_finds_this_machine_well_and_says_where_others_slow_it(capsys, monkeypatch, load):
    monkeypatch.setattr(doctor.os, "getloadavg", lambda: (load, 0.0, 0.0))
    if load > 1:  # what the estimate says is seen once
        monkeypatch.setattr(doctor, "_speed", lambda rate: [])
    status, output, _ = run(capsys, "doctor", "--frames", "20")
    assert status == 0, output
    assert ("estimate    make train-jepa takes about" in output) == (load < 1)
    assert ("other programs keep about 1.7 cores busy" in output) == (load > 1)
    assert "frames/s" in output
    assert f"mujoco {importlib.metadata.version('mujoco')}" in output


def test_doctor_names_the_package_to_mend(capsys, monkeypatch):
    version = importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "4.0.0" if name == "mujoco" else version(name))
    monkeypatch.setattr(doctor, "_TRIAL", "print('frames/s', {frames})")
    status, output, _ = run(capsys, "doctor", "--frames", "700")
    assert status == 1
    assert "700 frames/s" in output
    assert "mend: mujoco is 4.0.0 but has to be" in output


@pytest.mark.parametrize(
    ("trial", "said"),
    [
        (f"raise RuntimeError({missing_backend_message()!r})", "libegl1"),
        ("raise OSError('no such driver')", "no such driver"),
        ("import os; os.abort()", "exit status"),
        ("print('frames/s', 0.0)", "empty frames"),
    ],
)
def test_doctor_says_why_nothing_is_rendered(capsys, monkeypatch, trial, said):
    monkeypatch.setattr(doctor, "_TRIAL", trial)
    status, output, _ = run(capsys, "doctor")
    assert status == 1
    assert said in output.split("mend:")[1]
