"""``tsjepa zoo train NAME``: an entry of the zoo from nothing to its card, by one command that can be started again."""

from __future__ import annotations

import json
from pathlib import Path

from tsjepa.models import entries
from tsjepa.support.files import exclusive
from tsjepa.support.journal import Journal
from tsjepa.support.provenance import machine
from tsjepa.zoo.child import run
from tsjepa.zoo.figures import key_figures, table
from tsjepa.zoo.steps import ENTRIES, commands

FOLDER = "runs/zoo"


def train(name: str, seed: int = 0) -> Path:
    """Collects the data, fits, evaluates and exports; what is done is not done again.

    Every command is printed before it runs, and at the end how long each took on which machine, which the card says
    too, and the new figures beside those of the shipped entry. The shipped entry stays as it is.

    Args:
        name: of the entry.
        seed: of the training; the evaluation's starts stay the same.

    Returns:
        Folder of the entry.

    Raises:
        ValueError: there is no recipe for such an entry.
        RuntimeError: a command failed.
    """
    if name not in ENTRIES:
        raise ValueError(f"There is no recipe for {name!r}: choose one of {', '.join(ENTRIES)}.")
    home = Path(FOLDER) / (name if seed == 0 else f"{name}-seed{seed}")
    home.mkdir(parents=True, exist_ok=True)
    with exclusive(home):
        steps = commands(ENTRIES[name], home.as_posix(), name, seed)
        journal = Journal(home / "steps.journal", steps)
        for step, words in steps.items():
            if step in journal.done:
                print(f"{step}: done before, in {journal.done[step]['seconds']:.0f} s.", flush=True)
                continue
            if step == "export":
                words = [*words, "--trained_with", told(journal, name, seed)]
            if step not in ("evaluate", "export") and (home / step / "checkpoints" / "last.ckpt").is_file():
                words = [*words, "--ckpt_path", "last"]
            journal.add(step, {"seconds": run(words), "machine": machine()})
    entry = home / "entry" / name
    print(told(journal, name, seed))
    known = [key_figures(name)] if name in entries.names() else []
    print(table([key_figures(str(entry)), *known]))
    print(f"The new entry, the first row, is in {entry}.")
    return entry


def told(journal: Journal, name: str, seed: int) -> str:
    """A sentence on how the entry was made, for its card."""
    times = ", ".join(f"{step} {done['seconds']:.0f} s" for step, done in journal.done.items() if step != "export")
    on = {json.dumps(done["machine"]): done["machine"] for done in journal.done.values()}.values()
    where = "; ".join(f"{each['cores']} cores of {each['processor']}" for each in on)
    again = f"tsjepa zoo train {name}{f' --seed {seed}' if seed else ''}"
    return f"Made by `{again}`, data included: {times}, on {where}."
