"""One tiny data set, and a tiny TS-JEPA and its actor, that all faults are tried on."""

import os
import shutil
from pathlib import Path

import pytest
import tiny

from tsjepa import cli

RECIPE, DATA_RECIPE = "recipes/jepa.yaml", "recipes/data.yaml"
DATA, RUN, ACTOR = Path("data/cartpole"), Path("runs/jepa"), Path("runs/actor")


@pytest.fixture(scope="session")
def fitted(tmp_path_factory) -> Path:
    """A folder with the tiny recipes, their data set, and a run of recipes/jepa.yaml and of recipes/actor.yaml."""
    folder = tmp_path_factory.mktemp("fitted")
    for name in tiny.NAMES:
        tiny.write(folder, name, tiny.shrink(tiny.load(name)))
    before = Path.cwd()
    os.chdir(folder)
    try:
        for recipe in (RECIPE, "recipes/actor.yaml"):
            assert cli.main(["fit", "--config", recipe]) == 0
    finally:
        os.chdir(before)
    return folder


@pytest.fixture
def home(fitted, tmp_path, monkeypatch) -> Path:
    """A copy of it to break, as the working directory."""
    home = shutil.copytree(fitted, tmp_path / "home")
    monkeypatch.chdir(home)
    return home


@pytest.fixture
def command(capsys):
    """Runs a command in this process; gives its exit status, and the one line that it complained in."""

    def run(*arguments: str) -> tuple[int, str]:
        try:
            status = cli.main(arguments)
        except SystemExit as exit_:
            status = exit_.code
        lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("tsjepa")]
        assert len(lines) == (status != 0), lines
        return status, "".join(lines)

    return run
