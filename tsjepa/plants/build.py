"""Plants as plain values and back: how a recipe, a data set and a model name the machine that they belong to."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

from torch import nn

from tsjepa.plants.appearance import Appearance
from tsjepa.plants.plant import Plant
from tsjepa.support.description import build, describe


def build_plant(description: Mapping[str, Any], trusted: bool = False, **overrides: Any) -> Plant:
    """The plant of ``{"class_path": ..., "init_args": {...}}``.

    Args:
        description: what a recipe's ``plant:``, :func:`describe_plant` or a model's ``plant`` says.
        trusted: import classes that are not this package's own.
        overrides: arguments instead of those described, such as ``process_noise_std=0.05``.

    Raises:
        ValueError: it names no class, one that must not be imported, no plant, or arguments that it does not take.
    """
    if not isinstance(description, Mapping) or "class_path" not in description:
        raise ValueError(
            f"A plant is described by a class_path and init_args, such as class_path: tsjepa.plants.CartPole, not by "
            f"{description!r}."
        )
    arguments = {**(description.get("init_args") or {}), **overrides}
    return build({"class_path": description["class_path"], "init_args": arguments}, _part_of_a_plant, trusted)


def describe_plant(plant: Plant) -> dict[str, Any]:
    """Class path and arguments of a plant as plain values, for JSON and YAML.

    A plant keeps each argument of its constructor as an attribute of the same name.

    Raises:
        ValueError: an argument is not kept, or cannot be stored.
    """
    description = describe(plant, _part_of_a_plant)
    module, _, name = description["class_path"].rpartition(".")
    package = module.rpartition(".")[0]
    # by the package that offers it, so that the name outlives a move of the file
    if package and getattr(importlib.import_module(package), name, None) is type(plant):
        description["class_path"] = f"{package}.{name}"
    return description


def _part_of_a_plant(kind: type) -> bool:
    """A plant, or a policy or an appearance among its arguments."""
    return issubclass(kind, (nn.Module, Plant, Appearance))
