"""The commit in a result file is the code that made it."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tsjepa.support.provenance import commit_of, provenance


@pytest.fixture
def checkout(tmp_path):
    """A repository with one commit."""
    for name in ("tsjepa/evaluation/code.py", "recipes/fit.yaml", "docs/results.csv", "pyproject.toml"):
        write(tmp_path / name, "committed")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    git(tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", "commit", "--quiet", "-m", "all")
    return tmp_path


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def git(folder: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True, text=True).stdout


def commit(checkout: Path) -> str:
    return commit_of(checkout / "tsjepa" / "evaluation")


def test_committed_code_is_named_by_its_commit_whatever_results_are_being_written(checkout):
    write(checkout / "docs" / "results.csv", "changed")
    write(checkout / "checkpoints" / "new" / "metrics.json", "new")
    assert commit(checkout) == git(checkout, "rev-parse", "HEAD")[:10]


@pytest.mark.parametrize("name", ["tsjepa/evaluation/code.py", "tsjepa/new.py", "recipes/fit.yaml", "pyproject.toml"])
def test_changed_code_is_said_to_be_changed(checkout, name):
    head = git(checkout, "rev-parse", "HEAD")[:10]
    write(checkout / name, "changed")
    assert commit(checkout) == f"{head}-dirty"
    git(checkout, "add", ".")
    assert commit(checkout) == f"{head}-dirty"


def test_there_is_no_commit_without_a_checkout(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert commit_of(tmp_path) is None


@pytest.mark.parametrize(
    ("module", "program"),
    [
        ("tsjepa.cli.step", "tsjepa"),
        ("tsjepa.cli.__main__", "tsjepa"),
        ("pytest.__main__", "python -m pytest.__main__"),
    ],
)
def test_the_command_of_a_result_can_be_typed_again(monkeypatch, module, program):
    monkeypatch.setitem(sys.modules, "__main__", SimpleNamespace(__spec__=SimpleNamespace(name=module)))
    monkeypatch.setattr(sys, "argv", ["a/path.py", "evaluate", "--periods", "[1, 2]"])
    assert provenance()["command"] == f"{program} evaluate --periods '[1, 2]'"
    monkeypatch.setitem(sys.modules, "__main__", SimpleNamespace(__spec__=None))
    assert provenance()["command"] == "path.py evaluate --periods '[1, 2]'"
