"""The reference of commands and recipes: every option, from the parsers that read them."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import inspect
import io
import re
from pathlib import Path

import yaml
from jsonargparse import ArgumentParser

from tsjepa import cli
from tsjepa.support.recipes import PACKAGE, parser_of

# what a recipe of a fit may hold below `class_path`
PARTS = {
    "Models and modules": [
        "tsjepa.training.jepa.TSJEPA",
        "tsjepa.training.actor.SemanticActor",
        "tsjepa.training.supervised.Supervised",
        "tsjepa.training.autoencoder.Autoencoder",
        "tsjepa.models.Encoder",
        "tsjepa.models.DifferenceEncoder",
        "tsjepa.models.Predictor",
        "tsjepa.models.Decoder",
    ],
    "Data": [
        "tsjepa.data.module.Trajectories",
        "tsjepa.training.imitation_data.ImitationPairs",
        "tsjepa.data.augmentation.Augmentation",
    ],
    "Callbacks": [
        "tsjepa.training.monitor.RepresentationMonitor",
        "tsjepa.training.finish.centre.CentreEmbedding",
        "tsjepa.training.finish.refine.RefinePredictor",
        "tsjepa.training.finish.probe.FitProbe",
        "tsjepa.training.finish.decoder.FitDecoder",
        "tsjepa.training.finish.codec.FitCodec",
        "tsjepa.training.autoencoder.FitEstimator",
    ],
    "Plants": [
        "tsjepa.plants.CartPole",
        "tsjepa.plants.DoubleCartPole",
        "tsjepa.plants.Pendulum",
        "tsjepa.plants.Reacher",
        "tsjepa.plants.Suite",
        "tsjepa.plants.MuJoCo",
        "tsjepa.plants.Gym",
        "tsjepa.plants.Mixed",
    ],
}


def write_options(folder: Path) -> None:
    """Writes commands.md and recipes.md into ``folder``."""
    write_if_new(folder / "commands.md", commands())
    write_if_new(folder / "recipes.md", recipes())


def write_if_new(path: Path, text: str) -> None:
    """Leaves a file alone that holds ``text`` already, so that Sphinx does not read it again."""
    if not path.is_file() or path.read_text() != text:
        path.write_text(text)


def commands() -> str:
    """A page with the options of every command."""
    lines = ["# Commands", "", "`tsjepa COMMAND --help` prints the same. Options that hold a value of several", ""]
    lines[2] += " fields, such as `--radio`, are written with dots on the command line and nested in a recipe."
    for name, (_, summary) in cli.COMMANDS.items():
        lines += [f"## tsjepa {name}", "", f"{summary[0].upper()}{summary[1:]}.", ""]
        lines += table(parser_of(cli.function_of(name), f"tsjepa {name}"))
    for name, summary in cli.LIGHTNING_COMMANDS.items():
        lines += [f"## tsjepa {name}", "", f"{summary[0].upper()}{summary[1:]}. Options of Lightning, with ours:", ""]
        lines += [f"- `{option}`" for option in lightning_options(name)]
        lines += [""]
    return "\n".join(lines)


def table(parser) -> list[str]:
    """One row an option: name, type and default, what it is."""
    rows = ["| option | default | what it is |", "|---|---|---|"]
    for action in parser._actions:
        if not action.option_strings or action.dest in ("help", "config", "print_config"):
            continue
        if action.default == argparse.SUPPRESS:  # a group, whose fields have rows of theirs, or its help
            continue
        default = "required" if getattr(action, "required", False) else action.default
        rows.append(f"| `{action.option_strings[0]}` | {cell(default)} | {words(action.help)} |")
    return [*rows, ""]


def cell(value: object) -> str:
    """A default as it would stand in a recipe."""
    text = "null" if value is None else str(value)
    return f"`{text}`".replace("|", "\\|") if len(text) <= 60 else "several fields"


def words(text: str | None) -> str:
    """A help text on one line of a table."""
    text = re.sub(r"\(type: .*", "", text or "", flags=re.DOTALL)
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text)
    return " ".join(text.split()).replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;").replace("[", "\\[")


def lightning_options(name: str) -> list[str]:
    """The options that the help of a command of Lightning's lists."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        cli.main([name, "--help"])
    return sorted(set(re.findall(r"--[a-z][\w.]*\w", said.getvalue())))


def recipes() -> str:
    """A page with the shipped recipes, and what the classes that they name can be told."""
    home = next(home for home in (PACKAGE, PACKAGE.parent) if (home / "recipes").is_dir())
    lines = ["# Recipes", "", "A recipe is a YAML file with the options of a command. Several `--config` lie over", ""]
    lines[2] += " each other, and options on the command line win. The shipped ones:"
    lines += ["| recipe | what it is |", "|---|---|"]
    for path in sorted((home / "recipes").rglob("*.yaml")):
        first = path.read_text().splitlines()[0]
        said = first.removeprefix("#").strip() if first.startswith("#") else ", ".join(yaml.safe_load(path.read_text()))
        lines.append(f"| `{path.relative_to(home)}` | {words(said)} |")
    for heading, paths in PARTS.items():
        lines += ["", f"## {heading}", ""]
        for path in paths:
            module, _, name = path.rpartition(".")
            kind = getattr(importlib.import_module(module), name)
            summary = (inspect.getdoc(kind) or "").splitlines()[0]
            lines += [f"### {name}", "", f"`class_path: {path}`. {words(summary)}", ""]
            parser = ArgumentParser()
            parser.add_class_arguments(kind)
            lines += table(parser)
    return "\n".join(lines)
