"""Every command line on every page is one that the command line's own parser takes."""

import contextlib
import functools
import io

import pytest
from pages import PAGES, ROOT, command_lines

from tsjepa import cli
from tsjepa.support.recipes import find_recipe

WITH_COMMANDS = [page for page in PAGES if command_lines(page)]
ENDS = (">", ">>", "|", "&&", ";", "&")


def shipped(words: list[str]) -> list[str]:
    """The words up to where the shell takes over, without recipes that the page asks its reader to write."""
    words = words[: next((place for place, word in enumerate(words) if word in ENDS), len(words))]
    kept: list[str] = []
    for word in words:
        if kept and kept[-1] in ("--config", "-c") and not (ROOT / find_recipe(word)).is_file():
            kept.pop()
        else:
            kept.append(word)
    return kept


@functools.cache
def complaint(words: tuple[str, ...]) -> str:
    """What the parser has against a command line; "" where it takes it."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            status = cli.main([*words[1:], "--print_config"])
        except SystemExit as exit_:
            status = exit_.code
    return "" if status == 0 else said.getvalue() or f"status {status}"


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_command_lines_of_a_page_parse(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    wrong = {" ".join(words): said for words in command_lines(page) if (said := complaint(tuple(shipped(words))))}
    assert not wrong


def test_command_lines_are_found_where_they_stand():
    assert ["tsjepa", "fit", "--config", "recipes/jepa.yaml"] in command_lines("README.md")
    assert shipped(["tsjepa", "zoo", "--json", ">", "models.json"]) == ["tsjepa", "zoo", "--json"]
    assert shipped(["tsjepa", "fit", "--config", "absent.yaml", "--trust"]) == ["tsjepa", "fit", "--trust"]
    assert "perods" in complaint(("tsjepa", "evaluate", "--perods", "3"))
