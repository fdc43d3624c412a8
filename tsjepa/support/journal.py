"""What of a long run is done, so that the same command, started again after a kill, does only the rest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tsjepa.support.files import write_text


class Journal:
    """A file of JSON lines: the settings of the run, then one line ``[key, value]`` for every finished item.

    A line counts once it is whole. A journal of other settings is started anew.

    Args:
        path: of the file; its folder is there.
        settings: everything that the items depend on, as JSON.
    """

    def __init__(self, path: str | Path, settings: Any) -> None:
        self.path, self.settings = Path(path), json.loads(json.dumps(settings))
        self.done: dict[str, Any] = {}
        lines = _whole_lines(self.path)
        if lines[:1] == [self.settings]:
            self.done = dict(lines[1:])
        text = "".join(json.dumps(line) + "\n" for line in [self.settings, *map(list, self.done.items())])
        write_text(self.path, text)

    def add(self, key: str, value: Any = None) -> None:
        """Notes that the item ``key`` is done, with its result as JSON."""
        with self.path.open("a") as file:
            file.write(json.dumps([key, value]) + "\n")
        self.done[key] = json.loads(json.dumps(value))


def settings_in(path: str | Path) -> Any:
    """The settings of the run whose journal is at ``path``; None where there is none, or where it is damaged."""
    return next(iter(_whole_lines(Path(path))), None)


def _whole_lines(path: Path) -> list:
    if not path.is_file():
        return []
    try:
        return [json.loads(line) for line in path.read_text().split("\n")[:-1]]
    except ValueError:
        return []
