"""The pages of the documentation, and what stands in them."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LISTED = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
PAGES = [page for page in LISTED.split() if page.startswith("docs/") or "/" not in page]


def text_of(page: str) -> str:
    return (ROOT / page).read_text()


def blocks(page: str, *languages: str) -> list[str]:
    """The blocks of code of a page in any of ``languages``; "" is a block without one."""
    found = re.findall(r"^```(\S*)[^\n]*\n(.*?)^```$", text_of(page), flags=re.DOTALL | re.MULTILINE)
    return [block for language, block in found if language in languages]


def prose(page: str) -> str:
    """The page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", text_of(page), flags=re.DOTALL | re.MULTILINE)


def command_lines(page: str) -> list[list[str]]:
    """Every command line of the package on a page, in blocks and between backticks, as words.

    What is only named (`tsjepa fit`) and what stands for something else (`tsjepa fit ...`) is left out.
    """
    lines = [line for block in blocks(page, "sh", "bash", "console") for line in joined(block)]
    lines += [line.strip() for line in re.findall(r"^    (tsjepa .+)$", prose(page), flags=re.MULTILINE)]
    lines += [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose(page))]
    commands = []
    for line in lines:
        line = re.sub(r"^\$ |^(\w+=\S* )+|\.venv/bin/|\s+#.*$", "", line)
        words = shlex.split(line) if re.match(r"(tsjepa|lightning) [a-z]", line) and "..." not in line else []
        if len(words) > 2:
            commands.append(words)
    return commands


def joined(block: str) -> list[str]:
    """The lines of a block, with those that end in a backslash made one with the next."""
    return [line.strip() for line in block.replace("\\\n", " ").splitlines()]


def links(page: str) -> list[str]:
    """Targets of the links and pictures of a page."""
    return links_in(prose(page))


def links_in(text: str) -> list[str]:
    """Targets of the links and pictures of a text."""
    return re.findall(r"\]\(\s*([^)\s]+)[^)]*\)", text)
