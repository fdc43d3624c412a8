"""Objects as plain values and back: the class path and the arguments that rebuild one, for recipes and entries."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from tsjepa.support.foreign import reason
from tsjepa.support.nearest import did_you_mean
from tsjepa.support.trust import TRUST, may_import

Allowed = Callable[[type], bool]


def describe(value: Any, allowed: Allowed) -> Any:
    """Plain values for an object: ``{"class_path": ..., "init_args": {...}}``, everything inside it likewise.

    An object keeps each argument of its constructor as an attribute of the same name, or all of them in a dictionary
    ``init_args``; that is all it has to do to be stored. Tensors, arrays and tuples become lists.

    Args:
        value: an object whose class is allowed, or a plain value.
        allowed: the classes that may be described.

    Raises:
        ValueError: an argument of a constructor is not kept, or cannot be stored.
    """
    if allowed(type(value)):
        kind, arguments = type(value), {}
        for name, parameter in inspect.signature(kind).parameters.items():
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            kept = getattr(value, "init_args", None)
            if kept is None and not hasattr(value, name):
                raise ValueError(
                    f"{kind.__qualname__} cannot be stored, because it does not keep its argument {name!r}: set "
                    f"self.{name} in its constructor."
                )
            arguments[name] = describe(getattr(value, name) if kept is None else kept[name], allowed)
        return {"class_path": f"{kind.__module__}.{kind.__qualname__}", "init_args": arguments}
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [describe(item, allowed) for item in value]
    if isinstance(value, Mapping):
        return {name: describe(item, allowed) for name, item in value.items()}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise ValueError(f"{value!r} cannot be stored; use numbers, text, lists and objects that keep their arguments.")


def build(description: Any, allowed: Allowed, trusted: bool = False) -> Any:
    """What :func:`describe` has described, new and as the constructors make it.

    Args:
        description: plain values.
        allowed: the classes that may be built.
        trusted: import classes that are not this package's own.

    Raises:
        ValueError: it names a class that must not be imported or that there is not, arguments that it does not take or
            lacks, or a class that is not this package's own and fails to be made of them.
    """
    if isinstance(description, Mapping):
        if "class_path" not in description:
            return {name: build(value, allowed, trusted) for name, value in description.items()}
        kind = load_class(description["class_path"], allowed, trusted)
        arguments = {
            name: build(value, allowed, trusted) for name, value in (description.get("init_args") or {}).items()
        }
        path, parameters = description["class_path"], inspect.signature(kind).parameters
        if unknown := set(arguments) - set(parameters):
            raise ValueError(f"{path} has settings that this version does not know: {', '.join(sorted(unknown))}.")
        if lacking := [name for name in parameters if name not in arguments and _is_required(parameters[name])]:
            raise ValueError(f"{path} lacks its settings {', '.join(lacking)}: give them in its init_args.")
        if path.startswith("tsjepa."):
            return kind(**arguments)
        try:
            return kind(**arguments)
        except Exception as error:  # whatever the user's own code raises
            raise ValueError(f"{path} cannot be made of its settings: {reason(error)}") from error
    if isinstance(description, (list, tuple)):
        return tuple(build(item, allowed, trusted) for item in description)
    return description


def _is_required(parameter: inspect.Parameter) -> bool:
    named = parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    return named and parameter.default is parameter.empty


def load_class(path: Any, allowed: Allowed, trusted: bool = False) -> type:
    """The class of an import path.

    Raises:
        ValueError: it must not be imported, there is none, or it is of another kind.
    """
    kind = load_named("class", str(path), trusted)
    if not (isinstance(kind, type) and allowed(kind)):
        raise ValueError(f"{path} is no class that can be used here.")
    return kind


def load_named(what: str, path: str, trusted: bool = False) -> Any:
    """What an import path names; ``what`` is its kind in the errors.

    Raises:
        ValueError: it must not be imported, or there is none.
    """
    module, _, name = path.rpartition(".")
    if not may_import(path, trusted):
        raise ValueError(
            f"The {what} {path} is not this package's own: add {TRUST} (in Python trusted=True) if you trust whoever "
            "made it."
        )
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"The {what} {path} cannot be imported: {error}; run from the folder of your file with PYTHONPATH=. before "
            "the command, or install it."
        ) from error
    except Exception as error:  # whatever the module's own code raises
        raise ValueError(f"The {what} {path} cannot be imported: {reason(error)}") from error
    if not hasattr(found, name):
        raise ValueError(
            f"The {what} {path} cannot be imported: {module} has no {name!r}{did_you_mean(name, vars(found)) or '.'}"
        )
    return getattr(found, name)
