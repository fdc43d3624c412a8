"""Recipes: where they are found, and how one becomes the arguments of a typed function."""

from __future__ import annotations

import argparse
import inspect
import itertools
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tsjepa.support.description import load_named
from tsjepa.support.foreign import reason
from tsjepa.support.nearest import did_you_mean
from tsjepa.support.trust import PACKAGES, TRUST, may_import

if TYPE_CHECKING:
    from jsonargparse import ArgumentParser

PACKAGE = Path(__file__).parent.parent
# Where code lies that is not the user's own.
_INSTALLED = (PACKAGE, *(Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")))
# Lines of jsonargparse's messages that name its types instead of the mistake.
_NOISE = re.compile(
    r"Does not validate against any of the Union|Subtypes: |Errors:$|Expected (a )?<class 'NoneType'>"
    r"|Given value type: |Given value: \[?(NestedArg|Namespace)"
    r"|Expected a path but \S+ either not accessible or invalid$|Not a valid subclass of \w+$"
    r"|Subclass types expect one of:|a (class path|dict) "
)
# What jsonargparse says of an option or a key of a recipe that it does not know.
_UNKNOWN = re.compile(
    r"unrecognized arguments: --([\w.-]+)|does not accept option '([\w.]+)'|Option '([\w.]+)' is not accepted"
)
# How jsonargparse calls a list, a choice and a class.
_LIST = re.compile(r"Expected (?:a )?<class '(?:collections\.abc\.Sequence|tuple|list)'>")
_LIST_OF = re.compile(r"Expected a tuple with (\d+) elements")
_CHOICE = re.compile(r"Expected a typing\.Literal\[(.*?)\]")
_CLASS = re.compile(r"Expected a dot import path string: (\S+?)(?=;|$)")
_UNKNOWN_OF_CLASS = re.compile(r"class_path '([\w.]+)': Option '(\w+)' is not accepted")
_NO_CLASS = re.compile(r"\"(model|data)\": Problem with given class_path 'lightning\.Lightning(?:Data)?Module'")
# What an option names that cannot be imported or is not in its module.
_NOT_FOUND = re.compile(
    r"Problem with given class_path '([\w.]+)': (?:No module named|module '[\w.]+' has no attribute)"
    r"|a callable class: (?:No module named|module '[\w.]+' has no attribute) \S+\. Got value: ([\w.]+)"
)
_NO_SUBCLASS = re.compile(
    r"Subclasses are disabled for (\w+), thus '([\w.]+)' is not .*?subclasses_enabled=\[\w+\]\)\.?"
)
_ROLE = re.compile(r":\w+:`([^`]+)`")  # of reStructuredText
_DENIED = re.compile(r"Importing '([\w.]+)' is not allowed, denied by .*?set_parsing_settings to allow it\.?")


def find_recipe(path: str) -> str:
    """The file itself where the working directory has it, else the package's own (or the checkout's), else ``path``."""
    homes = (Path(), PACKAGE, PACKAGE.parent)
    return next((str(home / path) for home in homes if (home / path).is_file()), path)


def find_recipes(options: Sequence[str]) -> list[str]:
    """Applies :func:`find_recipe` to the words that name a recipe."""
    return [find_recipe(option) if option.startswith("recipes/") else option for option in options]


def one_sentence(message: str) -> str:
    """Distils the many lines of a jsonargparse message into one."""
    lines = [line.strip().removeprefix("- ").strip() for line in message.splitlines()]
    text = "; ".join(line for line in lines if line and not _NOISE.match(line)).replace(":; ", ": ")
    text = _LIST.sub('Expected a list, written "[a, b]"', text)
    text = _LIST_OF.sub(r"Expected a list of \1 elements", text)
    text = _CHOICE.sub(r"Expected one of \1", text)
    text = _CLASS.sub(r"no class \1 is known, give its import path, package.module.\1", text)
    text = re.sub(r"<class '([\w.]+)'>", r"\1", text)
    text = _NO_SUBCLASS.sub(r"\2 is not \1", text)
    if of := _NO_CLASS.search(text):
        return (
            f"the recipe names no class of the {of[1]}, as one that lies over another: give that one before it, such "
            "as --config recipes/jepa.yaml"
        )
    if denied := _DENIED.search(text):
        return f"{denied[1]} is not of {', '.join(PACKAGES)}: add {TRUST} if you trust the file that names it"
    missing = _NOT_FOUND.search(text)
    if missing and may_import(missing[1] or missing[2]):  # a recipe's values stand in the text too
        try:
            load_named("class" if missing[1] else "function", missing[1] or missing[2])
        except ValueError as error:  # what says how to mend it
            return str(error).rstrip(".")
    return re.sub(r'Parser key "([\w.]+)"', r"option '\1'", text).rstrip(".")


def failed_in_own_code(error: BaseException | None) -> str | None:
    """A sentence on code that a recipe names, and that is not installed, where it has failed to be imported or built.

    Returns:
        None where ``error``, with what has caused it, is another one.
    """
    while error is not None:
        places = [
            place for place in traceback.extract_tb(error.__traceback__) if "importlib._bootstrap" not in place.filename
        ]
        own = [place for place in places if not any(home in Path(place.filename).parents for home in _INSTALLED)]
        called = [
            place for caller, place in itertools.pairwise(places) if "jsonargparse" in Path(caller.filename).parts
        ]
        if any(place in own for place in called):
            return f"{Path(own[-1].filename).name}, line {own[-1].lineno}: {reason(error)}"
        error = error.__cause__ or error.__context__
    return None


def error_method(program: str) -> Callable:
    """Replaces ``ArgumentParser.error``, which prints a usage of hundreds of options before the message."""

    def error(parser: argparse.ArgumentParser, message: str, cause: Exception | None = None) -> None:
        if not parser.exit_on_error:
            # the parser of one of several types that an option may have: the next one may fit
            raise argparse.ArgumentError(None, message) from cause
        sentence = (failed_in_own_code(cause) or one_sentence(message)).rstrip(".")
        print(f"{program}: {sentence}{_meant(sentence, parser)} (options: {program} --help)", file=sys.stderr)
        raise SystemExit(2)

    return error


def _meant(sentence: str, parser: argparse.ArgumentParser) -> str:
    """The nearest option to one that is not known, where ``sentence`` is about that."""
    if of_class := _UNKNOWN_OF_CLASS.search(sentence):
        module, _, name = of_class[1].rpartition(".")
        kind = getattr(sys.modules.get(module), name, None)
        return did_you_mean(of_class[2], inspect.signature(kind).parameters) if kind else ""
    unknown = _UNKNOWN.search(sentence)
    return did_you_mean(next(filter(None, unknown.groups())), option_names(parser)) if unknown else ""


def option_names(parser: argparse.ArgumentParser) -> list[str]:
    """The options of a parser and of its commands, without the dashes."""
    commands = [
        command
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for command in action._name_parser_map.values()
    ]
    names = {name for each in (parser, *commands) for name in each._option_string_actions if name.startswith("--")}
    return sorted(name.removeprefix("--") for name in names)


def parse_arguments(function: Callable, options: Sequence[str], program: str, description: str = "") -> dict[str, Any]:
    """The arguments of a typed function from the words of a command line.

    Words before the first option are arguments in the order of the function's parameters: ``tsjepa export RUN NAME``.

    Args:
        function: whose parameters become options.
        options: words of the command line; ``--config RECIPE.yaml`` may be given several times, later ones win.
        program: named in errors.
        description: shown by ``--help``.

    Raises:
        SystemExit: 2 when an option is wrong, after one sentence; 0 after ``--help``.
    """
    parser = parser_of(function, program, description)
    values = parser.instantiate(parser.parse_args(_name_words(find_recipes(options), function)))
    del values["config"]
    return dict(values)


def parser_of(function: Callable, program: str, description: str = "") -> ArgumentParser:
    """The parser whose options are the parameters of a typed function."""
    from jsonargparse import ArgumentParser

    class Parser(ArgumentParser):
        error = error_method(program)

        def format_help(self, *formatter: Any) -> str:
            return _ROLE.sub(r"\1", super().format_help(*formatter))

    # an option that is cut short, such as --seed of --seeds, would be taken for another one's
    parser = Parser(prog=program, description=description, allow_abbrev=False)
    parser.add_argument("-c", "--config", action="config", help="a YAML file with any of the options below")
    parser.add_function_arguments(function)
    return parser


def _name_words(options: list[str], function: Callable) -> list[str]:
    words = itertools.takewhile(lambda option: not option.startswith("-"), options)
    parameters = inspect.signature(function).parameters.values()
    places = [parameter.name for parameter in parameters if parameter.kind is not parameter.KEYWORD_ONLY]
    named = [f"--{name}={word}" for name, word in zip(places, words, strict=False)]
    return named + options[len(named) :]
