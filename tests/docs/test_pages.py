"""The Python code on every page runs, its blocks one after the other."""

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from pages import DOCS, PAGES, blocks, command_lines

from tsjepa import cli

# needs frames; tests/docs/test_readme.py gives it some
ELSEWHERE = {"README.md"}
WITH_CODE = [page for page in PAGES if blocks(page, "python") and page not in ELSEWHERE]


def test_every_test_that_a_page_names_is_there():
    named = {name for page in DOCS.rglob("*.md") for name in re.findall(r"`(tests/[\w/]+\.py)`", page.read_text())}
    assert len(named) > 10
    assert [name for name in sorted(named) if not (DOCS.parent / name).is_file()] == []


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_on_a_page_runs(page, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    module = ModuleType("page_" + Path(page).stem.replace("-", "_"))  # a page may be called like a package
    monkeypatch.setitem(sys.modules, module.__name__, module)  # a class of the page is found by its path
    code = blocks(page, "python")
    for block in code:
        exec(compile(block, page, "exec"), vars(module))
    assert bool(capsys.readouterr().out.strip()) == ("print(" in "".join(code))


@pytest.mark.slow
def test_the_file_of_the_page_on_schedulers_runs_with_the_commands_of_the_page(monkeypatch, tmp_path):
    page = "docs/how-to/write-a-scheduler.md"
    (tmp_path / "my_scheduler.py").write_text(blocks(page, "python")[0])
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    commands = [words for words in command_lines(page) if "my_scheduler." in " ".join(words)]
    shorter = ["--controller=hold", "--seeds=2", "--slots=80", "--video=false"]
    assert len(commands) == 3
    for words in commands:
        assert cli.main([*words[1:], *shorter]) == 0, words
