"""``tsjepa completion SHELL``: a script that completes commands, options and files."""

from __future__ import annotations

import contextlib
import io
import re
from typing import Literal

from tsjepa.cli import command_line

BASH = """_tsjepa() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} words
  if [ "$COMP_CWORD" = 1 ]; then words="{commands}"; else
    case ${{COMP_WORDS[1]}} in
{cases}
    esac
  fi
  case $word in
    -*) ;;
    *) [ "$COMP_CWORD" = 1 ] || words= ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -F _tsjepa tsjepa
"""
FISH = "complete -c tsjepa -n '__fish_use_subcommand' -f -a {name} -d '{summary}'"
FISH_OPTION = "complete -c tsjepa -n '__fish_seen_subcommand_from {name}' -l {option}"


def completion(shell: Literal["bash", "zsh", "fish"]) -> str:
    """Prints the script; where it goes: ``tsjepa completion bash >> ~/.bashrc``, likewise ``~/.zshrc``, or
    ``~/.config/fish/completions/tsjepa.fish``.

    Args:
        shell: that is to complete.

    Returns:
        The script.
    """
    options = {name: options_of(name) for name in [*command_line.LIGHTNING_COMMANDS, *command_line.COMMANDS]}
    script = fish(options) if shell == "fish" else bash(options)
    if shell == "zsh":
        script = f"autoload -Uz bashcompinit && bashcompinit\n{script}"
    print(script, end="")
    return script


def options_of(command: str) -> list[str]:
    """The options of a command, as its help lists them; dots stand in the names of nested ones."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        command_line.main([command, "--help"])
    return sorted(set(re.findall(r"--[a-zA-Z][\w.-]*\w", said.getvalue())) | {command_line.JSON, command_line.TRUST})


def bash(options: dict[str, list[str]]) -> str:
    """For bash, and for zsh that emulates its completion."""
    cases = "\n".join(f'      {name}) words="{" ".join(words)}" ;;' for name, words in options.items())
    return BASH.format(commands=" ".join(options), cases=cases)


def fish(options: dict[str, list[str]]) -> str:
    """For fish."""
    commands = {**command_line.LIGHTNING_COMMANDS}
    commands |= {name: summary for name, (_, summary) in command_line.COMMANDS.items()}
    lines = [FISH.format(name=name, summary=summary.replace("'", "\\'")) for name, summary in commands.items()]
    for name, words in options.items():
        lines += [FISH_OPTION.format(name=name, option=word.removeprefix("--")) for word in words]
    return "\n".join(lines) + "\n"
