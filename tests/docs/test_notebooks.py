"""Every notebook runs from top to bottom, on tiny recipes and few slots."""

import json
import shlex

import matplotlib
import pytest
import tiny
from pages import DOCS, links_in

from tsjepa import cli

NOTEBOOKS = sorted(path.name for path in (DOCS / "tutorials").glob("*.ipynb"))
# What makes them long, replaced by what a test can afford; the names are those in the notebooks.
SHORT = {
    "SLOTS = 2000": "SLOTS = 80",
    "DEVICES, STEPS = 40, 100": "DEVICES, STEPS = 12, 12",
    "DEVICES, SLOTS, PERIODS = 20, 100, [1, 2, 5, 10, 20]": "DEVICES, SLOTS, PERIODS = 3, 20, [1, 5]",
    "DRIVES, SLOTS = 20, 60": "DRIVES, SLOTS = 6, 60",
}


def cells(name: str, kind: str) -> list[str]:
    """The sources of the cells of one kind."""
    found = json.loads((DOCS / "tutorials" / name).read_text())["cells"]
    return ["".join(cell["source"]) for cell in found if cell["cell_type"] == kind]


def run(source: str, names: dict) -> None:
    """Runs a cell; a line that begins with ! is a command of the package."""
    for long, short in SHORT.items():
        source = source.replace(long, short)
    if source.startswith("!"):
        program, *words = shlex.split(source[1:])
        assert program == "tsjepa"
        words += ["--frames", "20"] if words == ["doctor"] else []
        assert cli.main(words) == 0, source
    else:
        exec(compile(source, "cell", "exec"), names)


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs(name, tmp_path, monkeypatch):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    for recipe in ("data", "jepa", "actor", "evaluate"):
        tiny.write(tmp_path, f"recipes/{recipe}.yaml", tiny.shrink(tiny.load(f"recipes/{recipe}.yaml")))
    names: dict = {}
    for source in cells(name, "code"):
        run(source, names)
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_the_links_of_a_notebook_lead_somewhere(name):
    for link in links_in("\n".join(cells(name, "markdown"))):
        assert link.startswith("https://") or (DOCS / "tutorials" / link.partition("#")[0]).is_file(), link


def test_every_part_that_is_shortened_is_in_a_notebook():
    code = "".join(source for name in NOTEBOOKS for source in cells(name, "code"))
    assert all(long in code for long in SHORT)
