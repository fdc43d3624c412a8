"""The Python code on every page of the docs runs, its blocks one after the other."""

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(page.name for page in DOCS.glob("*.md") if "```python" in page.read_text())


def test_every_test_that_a_page_names_is_there():
    named = {name for page in DOCS.rglob("*.md") for name in re.findall(r"`(tests/[\w/]+\.py)`", page.read_text())}
    assert len(named) > 10
    assert [name for name in sorted(named) if not (DOCS.parent / name).is_file()] == []


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_code_on_a_page_runs(page, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    module = ModuleType(page.removesuffix(".md").replace("-", "_"))
    monkeypatch.setitem(sys.modules, module.__name__, module)  # a class of the page is found by its path
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), flags=re.DOTALL)
    for block in blocks:
        exec(compile(block, page, "exec"), vars(module))
    assert bool(capsys.readouterr().out.strip()) == ("print(" in "".join(blocks))
