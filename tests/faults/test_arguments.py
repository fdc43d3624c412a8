"""Whatever is wrong with the arguments of a command: exit status 2, one sentence, no traceback."""

import contextlib
import functools
import importlib
import inspect
import io
import os
from pathlib import Path

import pytest
import tiny
import yaml
from conftest import RECIPE
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tsjepa import cli

RECIPES = {
    "fit": RECIPE,
    "validate": RECIPE,
    "test": RECIPE,
    "predict": RECIPE,
    "collect": "recipes/data.yaml",
    "evaluate": "recipes/evaluate.yaml",
    "simulate": "recipes/fleet.yaml",
}
GARBAGE = [
    "many",
    "nan",
    "-1",
    "0",
    "1e400",
    "[]",
    "{}",
    "[1, two]",
    "null",
    "no/such/file",
    "!!int x",
    "{a: [",
    "",
    "\0",
]
# Wrong wherever such an option takes them, whatever its type is.
NEVER = ["many words", "{no_such_key: 1}", "[[], {}]", "{class_path: os.system}"]
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)


def answer(*arguments: str) -> tuple[int, str]:
    """Exit status and standard error of a command; an exception that nobody foresaw fails the test."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            status = cli.main(arguments)
        except SystemExit as exit_:
            status = exit_.code
    return status, said.getvalue()


def assert_refused(status: int, said: str) -> None:
    """Status 2 and one sentence; warnings of Lightning's may stand before it."""
    assert status == 2, (status, said)
    lines = [line for line in said.splitlines() if line.startswith("tsjepa")]
    assert len(lines) == 1 and said.splitlines()[-1] == lines[0], said
    assert "Traceback" not in said


def refused(*arguments: str) -> None:
    """Asserts that the arguments are refused."""
    assert_refused(*answer(*arguments))


@pytest.fixture(scope="module")
def work(fitted):
    """The folder of the tiny fit as the working directory; nothing here may write into it."""
    before = Path.cwd()
    os.chdir(fitted)
    yield fitted
    os.chdir(before)


def tries(command: str):
    """As many examples as a second allows; Lightning's commands share one parser, which takes long to build."""
    examples = 4 if command == "fit" else 1 if command in cli.LIGHTNING_COMMANDS else 10
    return settings(max_examples=examples, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("command", [*cli.LIGHTNING_COMMANDS, *cli.COMMANDS])
def test_options_that_there_are_not(work, command):
    @tries(command)
    @given(words.filter(lambda word: word.isidentifier()), words)
    def check(name, value):
        refused(command, f"--{name}x", value)

    check()


@pytest.mark.parametrize("command", [*cli.LIGHTNING_COMMANDS, *cli.COMMANDS])
def test_recipes_that_are_none(work, tmp_path, command):
    @tries(command)
    @given(st.binary(max_size=60) | words.map(str.encode) | st.sampled_from([b"- a", b"3", b"{", b"a: !!python/none"]))
    def check(content):
        path = tmp_path / "recipe.yaml"
        path.write_bytes(b"no_such_option: 1\n" + content)
        refused(command, "--config", str(path))

    check()
    refused(command, "--config", str(tmp_path))
    refused(command, "--config", str(tmp_path / "absent.yaml"))


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_values_are_taken_or_refused(work, monkeypatch, command):
    """Whatever the value: the command runs with it (here, one that does nothing), or says in one sentence why not."""
    path, name = cli.COMMANDS[command][0].split(":")
    module = importlib.import_module(path)
    function = getattr(module, name)
    monkeypatch.setattr(module, name, functools.wraps(function)(lambda **values: None))
    monkeypatch.setattr(cli.command_line, "exclusive", lambda folder: contextlib.nullcontext())
    base = ["--config", RECIPES[command]] if command in RECIPES else []

    @tries(command)
    @given(st.sampled_from(list(inspect.signature(function).parameters)), st.sampled_from(GARBAGE) | words)
    def check(option, value):
        arguments = (command, *base, f"--{option}={value}")
        status, said = answer(*arguments)
        if status:
            assert_refused(status, said)

    check()


@pytest.mark.parametrize("command", cli.LIGHTNING_COMMANDS)
def test_settings_of_a_fit_of_the_wrong_type(work, command):
    @tries(command)
    @given(st.sampled_from(list(paths(yaml.safe_load(Path(RECIPE).read_text())))), st.sampled_from(NEVER))
    def check(path, value):
        refused(command, "--config", RECIPE, f"--{path}={value}")

    check()


def paths(recipe: dict, above: str = ""):
    """Dotted paths of the settings of a recipe that are no text, and so have a type that can be missed."""
    for key, value in recipe.items():
        if isinstance(value, dict):
            yield from paths(value, f"{above}{key}.")
        elif key not in ("callbacks", "logger") and not isinstance(value, str):
            yield above + key


WRONG = {
    "collect": [
        ("splits", "{}"),
        ("splits", "{train: {episodes: 0}}"),
        ("splits", "{../train: {episodes: 1}}"),
        ("slots", "0"),
        ("slots", "-3"),
        ("sampling_interval", "0"),
        ("sampling_interval", "-0.02"),
        ("sampling_interval", "nan"),
        ("workers", "0"),
        ("workers", "many"),
        ("coverage", "{hold_slots: 0}"),
        ("coverage", "{noise_std: nan}"),
        ("path", "recipes/data.yaml"),
    ],
    "simulate": [
        ("num_devices", "0"),
        ("num_devices", "-1"),
        ("schedulers", "[]"),
        ("schedulers", "[nobody]"),
        ("controller", "nobody"),
        ("seeds", "1"),
        ("seeds", "-1"),
        ("search_over", "[3]"),
        ("search_over", "[3, 2]"),
        ("search_over", "[0, 2]"),
        ("radio", "{resource_blocks: 0}"),
        ("radio", "{resource_blocks: -1}"),
        ("radio", "{resource_blocks: 50}"),
        ("radio", "{codec: zip}"),
        ("radio", "{csi: none}"),
        ("radio", "{csi: delayed, csi_delay: -1}"),
        ("radio", "{max_doppler_hz: -1}"),
        ("radio", "{snr_target_db: nan}"),
        ("slots", "0"),
        ("frame_history", "0"),
        ("plant", "null"),
        ("plant", "{class_path: tsjepa.plants.Nothing}"),
        ("plant", "{class_path: os.system, init_args: {command: ls}}"),
        ("plant", "{class_path: tsjepa.plants.CartPole, init_args: {sampling_interval: 0}}"),
        ("plant", "{class_path: tsjepa.plants.CartPole, init_args: {process_noise_std: -1}}"),
        ("plant", "{class_path: tsjepa.plants.CartPole, init_args: {mass: 1}}"),
    ],
    "evaluate": [
        ("model", "nobody"),
        ("model", "recipes"),
        ("data", "nowhere"),
        ("periods", "[-1]"),
        ("seeds", "0"),
        ("starts_per_seed", "0"),
        ("slots", "0"),
        ("frame_history", "0"),
        ("process_noise_std", "-1"),
        ("plant", "{init_args: {}}"),
        ("device", "abacus"),
        ("blend", "nan"),
        ("blend", "2"),
        ("codec", "zip"),
    ],
    "fit": [
        ("model.init_args.encoder.init_args.widths", "[4, 8]"),
        ("model.init_args.encoder.init_args.widths", "[0, 0, 0]"),
        ("model.init_args.encoder.init_args.embedding_dim", "0"),
        ("model.init_args.encoder.init_args.embedding_dim", "7"),
        ("model.init_args.encoder.init_args.frame_stack", "0"),
        ("model.init_args.predictor.init_args.embedding_dim", "3"),
        ("model.init_args.ema_decay", "2"),
        ("model.init_args.optimizer.init_args.lr", "-1"),
        ("data.init_args.path", "recipes/data.yaml"),
        ("data.init_args.frame_stack", "0"),
        ("data.init_args.frame_stack", "1"),
        ("data.init_args.frame_spacing", "0"),
        ("data.init_args.stacks", "0"),
        ("data.init_args.stacks", "1"),
        ("data.init_args.stacks", "1000"),
        ("data.init_args.frames_per_batch", "0"),
        ("data.init_args.frames_per_batch", "13"),
        ("data.init_args.steps", "[]"),
        ("data.init_args.steps", "[0]"),
        ("data.init_args.episodes", "0"),
        ("trainer.max_epochs", "-7"),
        ("trainer.precision", "3"),
        ("trainer.accelerator", "abacus"),
        ("trainer.devices", "0"),
        ("ckpt_path", "absent.ckpt"),
        ("ckpt_path", "recipes/data.yaml"),
    ],
}
EXPORTS = [("nobody", "name"), ("runs/actor", "../name"), ("runs/actor", ""), ("", "name"), ("recipes", "name")]


@pytest.mark.parametrize(
    ("command", "option", "value"), [(command, *wrong) for command, many in WRONG.items() for wrong in many]
)
def test_values_that_cannot_be(work, tmp_path, command, option, value):
    elsewhere = {"collect": "--path", "simulate": "--output", "evaluate": "--output"}
    where = [f"{elsewhere[command]}={tmp_path}/new"] if command in elsewhere else []
    where += ["--model=runs/actor/model"] if command == "evaluate" else []
    refused(command, "--config", RECIPES[command], *where, f"--{option}={value}")


@pytest.mark.parametrize(("run", "name"), EXPORTS)
def test_exports_that_cannot_be(work, run, name):
    refused("export", "--run", run, "--name", name)


def test_all_commands_are_tried():
    assert set(WRONG) | {"export", "validate", "test", "predict"} <= {*cli.LIGHTNING_COMMANDS, *cli.COMMANDS}
    assert tiny.NAMES
