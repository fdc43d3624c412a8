"""``tsjepa zoo train NAME``: an entry of the zoo from nothing to its card, by one command that can be started again."""

from __future__ import annotations

import json
import re
import shlex
from hashlib import sha256
from pathlib import Path

import yaml

from tsjepa.models import entries
from tsjepa.support.checks import at_least
from tsjepa.support.files import exclusive, read_json, write_json
from tsjepa.support.journal import Journal, settings_in
from tsjepa.support.nearest import did_you_mean
from tsjepa.support.provenance import machine
from tsjepa.support.recipes import find_recipe
from tsjepa.zoo.child import run
from tsjepa.zoo.figures import listed
from tsjepa.zoo.steps import ENTRIES, FRESH, VALIDATION, Made, before, evaluation, fits, run_of
from tsjepa.zoo.training_seeds import over_seeds, validation_error

FOLDER = "runs/zoo"
SEEDS_FILE = "training_seeds.json"
COLLECTED = " with collecting the data"
RECIPE = re.compile(r"recipes/[\w./-]+\.yaml")


def train(name: str, seeds: int = 1) -> Path:
    """Collects the data, fits, evaluates and exports; what is done is not done again.

    Every command is printed before it runs, and at the end how long each took on which machine, which the card says
    too, and the new figures beside those of the shipped entry. The shipped entry stays as it is.

    Of several training seeds the one is exported whose commands are nearest to the expert's on trajectories that no fit
    learns from, before any of them has met the evaluation's starts. All of them are then evaluated on starts of their
    own, which no recipe was chosen on.

    Args:
        name: of the entry.
        seeds: how many training seeds, from 0 on. Those that are there from an earlier start with fewer stay.

    Returns:
        Folder of the entry.

    Raises:
        ValueError: there is no recipe for such an entry, or no seed; or what is there was made by other recipes or
            commands.
        RuntimeError: a command failed.
    """
    if name not in ENTRIES:
        meant = did_you_mean(name, ENTRIES) or f": choose one of {', '.join(ENTRIES)}."
        raise ValueError(f"There is no recipe for {name!r}{meant}")
    at_least(1, seeds=seeds)
    made, home = ENTRIES[name], Path(FOLDER) / name
    home.mkdir(parents=True, exist_ok=True)
    with exclusive(home):
        homes = [f"{home.as_posix()}/seed{seed}" for seed in range(seeds)]
        times = [fitted(made, of_seed, seed) for seed, of_seed in enumerate(homes)]
        models = [entries.fingerprint(f"{run_of(made, each)}/model") for each in homes]
        journal = Journal(home / "steps.journal", {"models": models, "recipes": hashes(evaluation(made, homes[0], ""))})
        best = shipped(made, homes, journal)
        do(journal, "evaluate", evaluation(made, homes[best], f"{home.as_posix()}/evaluation"))
        options = ["--evaluation", f"{home.as_posix()}/evaluation/evaluation.json", "--half", "true"]
        if seeds > 1:
            together = compare(made, homes, journal, best)
            write_json(home / SEEDS_FILE, together)
            options += ["--training_seeds", f"{home.as_posix()}/{SEEDS_FILE}"]
        said = told([*times, journal.done], name, seeds)
        if not made.decoder:
            options += ["--decoder", "false"]
        options += ["--folder", f"{home.as_posix()}/entry", "--trained_with", said]
        do(journal, "export", ["export", run_of(made, homes[best]), name, *options])
    entry = home / "entry" / name
    print(said)
    listed([str(entry), *([name] if name in entries.names() else [])])
    print(f"The new entry, the first row, is in {entry}. To ship it: {shlex.join(installing(entry))}")
    return entry


def fitted(made: Made, home: str, seed: int) -> dict[str, dict]:
    """All fits of a training seed, those that are done before left out; how long each took, and where.

    Raises:
        ValueError: what lies in ``home`` was made by other commands or recipes, or a fit that is done has started from
            other weights than ``made.after`` has.
    """
    folder = Path(home)
    folder.mkdir(parents=True, exist_ok=True)
    earlier, first = {}, None
    if made.after is not None:
        base = before(made, home)
        Path(base).parent.mkdir(parents=True, exist_ok=True)
        with exclusive(Path(base).parent):
            earlier = fitted(ENTRIES[made.after], base, seed)
        first = entries.fingerprint(f"{run_of(ENTRIES[made.after], base)}/model")
    steps = fits(made, home, seed)
    settings = {"commands": steps, "recipes": hashes(*steps.values())}
    path = folder / "steps.journal"
    # its checkpoints and models would go on as those of these recipes
    if (path.is_file() or any((folder / step).exists() for step in steps)) and settings_in(path) != settings:
        raise ValueError(
            f"What is in {home} was made by other recipes, commands or versions than there are: move it away and start "
            "again."
        )
    journal = Journal(path, settings)
    for fit, (step, words) in zip(made.fits, steps.items(), strict=True):
        if step in journal.done and journal.done[step].get("first") != first:
            raise ValueError(
                f"{home}/{step} has started from another {made.after} than there is: move {home} away and start again."
            )
        begun = (folder / step / "checkpoints" / "last.ckpt").is_file()
        collects = not Path(fit.data or made.data).is_dir()
        do(journal, step, [*words, "--ckpt_path", "last"] if begun else words, collects=collects, first=first)
    return earlier | journal.done


def hashes(*commands: list[str]) -> dict[str, str]:
    """SHA-256 of every recipe that ``commands`` name, and of those that these name in turn, by its path."""
    digests: dict[str, str] = {}
    named = RECIPE.findall(" ".join(word for words in commands for word in words))
    while named:
        name = named.pop()
        if name not in digests:
            said = json.dumps(yaml.safe_load(Path(find_recipe(name)).read_text()))  # whatever its comments say
            digests[name] = sha256(said.encode()).hexdigest()
            named += RECIPE.findall(said)
    return digests


def do(journal: Journal, step: str, words: list[str], **notes: object) -> None:
    """Runs the command of a step that is not done yet, and notes its time, the machine and ``notes``."""
    if step in journal.done:
        where = journal.path.parent.as_posix()
        print(f"{where}, {step}: done before, in {journal.done[step]['seconds']:.0f} s.", flush=True)
    else:
        journal.add(step, {"seconds": run(words), "machine": machine(), **notes})


def shipped(made: Made, homes: list[str], journal: Journal) -> int:
    """The training seed whose model becomes the entry."""
    if len(homes) == 1:
        return 0
    if "validation" not in journal.done:
        models = [f"{run_of(made, home)}/model" for home in homes]
        journal.add("validation", [validation_error(model, made.data, VALIDATION) for model in models])
    errors = journal.done["validation"]
    best = min(range(len(errors)), key=errors.__getitem__)
    each = ", ".join(f"{error:.4f}" for error in errors)
    print(f"Command NMAE on {VALIDATION} by training seed: {each}. Seed {best} becomes the entry.", flush=True)
    return best


def compare(made: Made, homes: list[str], journal: Journal, best: int) -> dict:
    """Evaluates all training seeds on fresh starts; what their figures are together."""
    for seed, home in enumerate(homes):
        words = evaluation(made, home, f"{home}/fresh")
        do(journal, f"evaluate seed {seed}", [*words, "--first_seed", str(FRESH), "--video", "false"])
    evaluations = [read_json(Path(home, "fresh", "evaluation.json")) for home in homes]
    return over_seeds(evaluations, journal.done["validation"], best, made.data, VALIDATION)


def told(times: list[dict[str, dict]], name: str, seeds: int) -> str:
    """A sentence on how the entry was made, for its card.

    Args:
        times: what is done of each training seed, and of what follows.
        name, seeds: as in :func:`train`.
    """
    *of_seeds, last = [
        ", ".join(
            f"{step} {done['seconds']:.0f} s{COLLECTED * done.get('collects', False)}" for step, done in timed(each)
        )
        for each in times
    ]
    named = of_seeds if seeds == 1 else [f"seed {seed}: {each}" for seed, each in enumerate(of_seeds)]
    on = {json.dumps(done["machine"]): done["machine"] for each in times for _, done in timed(each)}
    where = "; ".join(f"{each['cores']} cores of {each['processor']} ({each['flags']})" for each in on.values())
    again = f"tsjepa zoo train {name}{f' --seeds {seeds}' if seeds > 1 else ''}"
    return f"Made by `{again}`: {'; '.join([*named, last])}, on {where}."


def timed(done: dict[str, dict]) -> list[tuple[str, dict]]:
    """The commands that make and evaluate, with how long they took and where."""
    return [(step, each) for step, each in done.items() if step not in ("validation", "export")]


def installing(entry: Path) -> list[str]:
    """The command that puts an entry into the place of the shipped one."""
    return ["cp", "-r", entry.as_posix(), f"{entries.zoo_folder().as_posix()}/"]
