"""The Python code on every page runs, its blocks one after the other."""

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from pages import DOCS, PAGES, blocks

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
