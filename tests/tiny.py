"""The recipes, and what makes them tiny enough for a test."""

import re
from pathlib import Path

import yaml

ROOT = Path(__file__).parent.parent
NAMES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "recipes").rglob("*.yaml"))

# What is replaced in every recipe, wherever the key stands.
SIZES = {
    "widths": [4, 8, 8],
    "embedding_dim": 16,
    "hidden_dim": 32,
    "hidden_dims": [32, 16],
    "frames_per_batch": 64,
    "batch_size": 64,
    "horizon": 5,
    "max_epochs": 2,
    "steps_per_epoch": 4,
    "check_val_every_n_epoch": 1,
    "log_every_n_steps": 1,
    "episodes": 2,
    "seeds": 2,
    "starts_per_seed": 6,
    "num_devices": 6,
    "resource_blocks": 3,
    "search_over": [2, 4],
    "periods": [1, 5, 0],
    "enable_progress_bar": False,
}
CALLBACK_STEPS = 4


def shrink(value):
    """The recipe with every size in it made tiny; its paths, classes and weights stay as they are."""
    if isinstance(value, list):
        return [shrink(item) for item in value]
    if not isinstance(value, dict):
        return value
    small = {key: SIZES[key] if key in SIZES and item is not None else shrink(item) for key, item in value.items()}
    if "default_root_dir" in small:
        small |= {"precision": "32-true", "max_epochs": SIZES["max_epochs"]}  # the same on every machine
    if isinstance(small.get("slots"), int):
        small["slots"] = min(small["slots"], 100)
    if isinstance(small.get("steps"), int):
        small["steps"] = CALLBACK_STEPS
    return small


def replace(value, changes: dict):
    """The recipe with these keys changed wherever they stand."""
    if isinstance(value, list):
        return [replace(item, changes) for item in value]
    if not isinstance(value, dict):
        return value
    return {key: changes.get(key, replace(item, changes)) for key, item in value.items()}


def load(name: str) -> dict:
    """A recipe as it is shipped."""
    return yaml.safe_load((ROOT / name).read_text())


def write(folder: Path, name: str, recipe: dict) -> None:
    """Writes a recipe where commands that run in ``folder`` find it first."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(recipe))


def command_of(name: str) -> list[str]:
    """The words of the command that the head of the recipe tells the user to type, without the program's name."""
    head = " ".join(line.lstrip("# ") for line in (ROOT / name).read_text().splitlines()[:2] if line.startswith("#"))
    found = re.search(rf"(?:tsjepa|lightning) (\w+(?: --config [\w./-]+)*? --config {re.escape(name)})", head)
    assert found, f"the head of {name} names no command that runs it: {head}"
    return found[1].split()


def layers(name: str) -> list[str]:
    """The recipes that the command of :func:`command_of` lays over each other, the base first."""
    return [word for word in command_of(name) if word.endswith(".yaml")]


def merged(name: str) -> dict:
    """The recipe as its command makes it of its layers; a class that is named anew takes its arguments along."""

    def over(low, high):
        if not (isinstance(low, dict) and isinstance(high, dict)) or "class_path" in high:
            return high
        return {
            key: over(low[key], high[key]) if key in low and key in high else {**low, **high}[key]
            for key in {**low, **high}
        }

    recipe = {}
    for layer in layers(name):
        recipe = over(recipe, load(layer))
    return recipe


def strings(value) -> set[str]:
    """All strings in a recipe."""
    if isinstance(value, str):
        return {value}
    items = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return set().union(*(strings(item) for item in items))


def exported(recipe: dict) -> str | None:
    """The folder in which a fit leaves its model."""
    root = recipe.get("trainer", {}).get("default_root_dir")
    return f"{root}/model" if root else None
