"""Sphinx: `make docs` builds the site into docs/_build, with warnings as errors and without the network."""

from __future__ import annotations

import importlib.metadata
import re
import sys
import zlib
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from options import write_options  # noqa: E402 - a neighbour of this file

project, author = "tsjepa", "The tsjepa authors"
copyright = author
release = importlib.metadata.version("tsjepa")
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = ["_build", "**.ipynb_checkpoints"]
html_theme, html_title = "furo", "tsjepa"
html_static_path = ["_static"]
html_css_files = ["wide.css"]

myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # tests/docs/test_notebooks.py executes them
copybutton_prompt_text = r"\$ "
copybutton_prompt_is_regexp = True
suppress_warnings = ["misc.highlighting_failure"]

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_default_options = {"members": True, "imported-members": True}
napoleon_use_ivar = True  # the fields of a NamedTuple are documented once, where its docstring lists them
napoleon_numpy_docstring = False

# What docstrings refer to. The projects' own inventories would need the network at every build.
FOREIGN = {
    "torch": (
        "https://docs.pytorch.org/docs/stable",
        ["torch.nn.Module py:class 1 generated/torch.nn.Module.html#$ -", "torch.Tensor py:class 1 tensors.html#$ -"],
    ),
    "torchrl": (
        "https://docs.pytorch.org/rl/stable",
        [
            f"torchrl.envs.{name} py:class 1 reference/generated/torchrl.envs.{name}.html#$ -"
            for name in ("EnvBase", "TransformedEnv")
        ],
    ),
    "tensordict": (
        "https://docs.pytorch.org/tensordict/stable",
        [
            f"tensordict.{name} py:class 1 reference/generated/tensordict.{name}.html#$ -"
            for name in ("TensorDict", "TensorDictBase")
        ],
    ),
}


def write_inventory(name: str, lines: list[str]) -> str:
    """An inventory as Sphinx reads it, in docs/_build; returns its path relative to this folder."""
    path = HERE / "_build" / f"{name}.inv"
    path.parent.mkdir(exist_ok=True)
    head = f"# Sphinx inventory version 2\n# Project: {name}\n# Version: \n"
    head += "# The remainder of this file is compressed using zlib.\n"
    path.write_bytes(head.encode() + zlib.compress("\n".join([*lines, ""]).encode()))
    return path.relative_to(HERE).as_posix()


intersphinx_mapping = {name: (url, write_inventory(name, lines)) for name, (url, lines) in FOREIGN.items()}


def plain_words(app, what, name, obj, options, lines: list[str]) -> None:
    """Docstrings name shapes such as [*B, d] and sizes such as |x|, which are no emphasis and no substitution."""
    for index, line in enumerate(lines):
        parts = re.split(r"(``.*?``|:\w+:`.*?`|`.*?`_?)", line)
        parts[::2] = [re.sub(r"(?<![\\*])\*(?=\w)|(?<!\\)\||(?<=\w)_(?=\W|$)", r"\\\g<0>", part) for part in parts[::2]]
        lines[index] = "".join(parts)


def setup(app) -> None:
    app.connect("autodoc-process-docstring", plain_words, priority=900)
    app.connect("builder-inited", lambda app: write_options(HERE / "reference"))
