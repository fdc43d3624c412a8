"""Modules as plain values and back: the class path and the arguments that rebuild one, for an entry on disk."""

from __future__ import annotations

import importlib
import inspect
from typing import Any

from torch import Tensor, nn

from tsjepa.support.spec import PlantSpec
from tsjepa.support.trust import TRUST, may_import

BUILT = (nn.Module, PlantSpec)  # what a description may name


def describe(value: Any) -> Any:
    """Plain values for a module (or spec): ``{"class_path": ..., "init_args": {...}}``, everything inside it likewise.

    A module keeps each argument of its constructor as an attribute of the same name; that is all it has to do to be
    stored. Tensors and tuples become lists.

    Raises:
        ValueError: an argument of a constructor is not kept.
    """
    if isinstance(value, BUILT):
        kind, arguments = type(value), {}
        for name, parameter in inspect.signature(kind).parameters.items():
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            if not hasattr(value, name):
                raise ValueError(
                    f"{kind.__qualname__} cannot be stored, because it does not keep its argument {name!r}: set "
                    f"self.{name} in its constructor."
                )
            arguments[name] = describe(getattr(value, name))
        return {"class_path": f"{kind.__module__}.{kind.__qualname__}", "init_args": arguments}
    if isinstance(value, Tensor):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [describe(item) for item in value]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise ValueError(f"{value!r} cannot be stored with a model; use numbers, text, lists and modules.")


def build(description: Any, trusted: bool = False) -> Any:
    """What :func:`describe` has described, new and with weights as the constructors draw them.

    Args:
        description: plain values.
        trusted: import classes that are not this package's own.

    Raises:
        ValueError: it names a class that must not be imported, that there is not, or arguments that it does not take.
    """
    if isinstance(description, dict) and "class_path" in description:
        kind = _class(description["class_path"], trusted)
        arguments = {name: build(value, trusted) for name, value in (description.get("init_args") or {}).items()}
        if unknown := set(arguments) - set(inspect.signature(kind).parameters):
            raise ValueError(
                f"{description['class_path']} has settings that this version does not know: "
                f"{', '.join(sorted(unknown))}."
            )
        return kind(**arguments)
    if isinstance(description, list):
        return tuple(build(item, trusted) for item in description)
    return description


def _class(path: Any, trusted: bool) -> type:
    module, _, name = str(path).rpartition(".")
    if not may_import(str(path), trusted):
        raise ValueError(
            f"The model names the class {path}, which is not this package's own: load it with {TRUST} (in Python "
            "trusted=True) if you trust whoever made it."
        )
    try:
        kind = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"The model names the class {path}, which cannot be imported: {error}.") from error
    if not (isinstance(kind, type) and issubclass(kind, BUILT)):
        raise ValueError(f"The model names {path}, which is no module.")
    return kind
