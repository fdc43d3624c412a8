"""Every recipe on a page is one that the command it is for takes, with the class or function that the page defines."""

import re

import jsonargparse
import pytest
import yaml
from pages import PAGES, ROOT, blocks
from test_commands import complaint

WITH_RECIPES = [page for page in PAGES if blocks(page, "yaml")]


def lies_over(recipe: dict) -> list[str]:
    """The command, and the shipped recipe over which one with these keys is put."""
    if "radio" in recipe:
        return ["simulate", "--config", "recipes/fleet.yaml"]
    if "model" not in recipe and "trainer" not in recipe:
        return ["collect", "--config", "recipes/data.yaml"]
    actor = "pretrained" in recipe.get("model", {}).get("init_args", {})
    return ["fit", "--config", f"recipes/{'actor' if actor else 'jepa'}.yaml"]


def wrong_recipes(texts: list[str], folder) -> dict[str, str]:
    """Those that the parser refuses, and what it says."""
    complaints = {}
    for number, text in enumerate(texts):
        path = folder / f"recipe_{number}.yaml"
        path.write_text(text)
        words = ["tsjepa", *lies_over(yaml.safe_load(text)), "--config", str(path), "--trust"]
        if said := complaint(tuple(words)):
            complaints[text] = said
    return complaints


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_RECIPES)
def test_the_recipes_on_a_page_parse(page, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(str(tmp_path))
    # the restriction lasts as long as a process, and this one has run other commands
    monkeypatch.setitem(jsonargparse._common.parsing_settings, "import_path_verdicts", {})
    recipes = blocks(page, "yaml")
    for module, name in re.findall(r"\b(my_\w+)\.(\w+)", "".join(recipes)):
        (code,) = [
            block for block in blocks(page, "python") if re.search(rf"^(class|def) {name}\b", block, re.MULTILINE)
        ]
        (tmp_path / f"{module}.py").write_text(code)
    assert list(wrong_recipes(recipes, tmp_path).values()) == []


def test_a_recipe_with_a_misspelt_field_would_be_found(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert "spectrum" in "".join(wrong_recipes(["radio: {spectrum: 3}"], tmp_path).values())
    assert "trials" in "".join(wrong_recipes(["model: {init_args: {trials: 3}}"], tmp_path).values())
