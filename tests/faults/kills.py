"""Kills every command at random moments, starts it again, and compares what it leaves with an undisturbed run.

    python tests/faults/kills.py --kills 50 --output docs/results/faults.json

A kill survives if, right after it, whatever is in place of the result is whole (an earlier one, or the final one), and
if the same command, started again, leaves bit for bit what it leaves undisturbed. Each command runs in a process forked
from this one, which has the packages imported, so a kill costs seconds.
"""

import argparse
import json
import os
import random
import shutil
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
os.environ.setdefault("OMP_NUM_THREADS", "1")

import tiny
import tiny_controller
import torch

from tsjepa import cli
from tsjepa.data.storage import read_metadata
from tsjepa.envs import FleetEnv  # noqa: F401 - imported before the fork; it makes no GL context
from tsjepa.evaluation import evaluate, simulate  # noqa: F401
from tsjepa.models import entries
from tsjepa.support.files import write_text
from tsjepa.support.provenance import provenance
from tsjepa.training import actor, jepa, monitor, resume  # noqa: F401
from tsjepa.training.finish import probe, refine  # noqa: F401
from tsjepa.zoo import export  # noqa: F401

JEPA, DATA, SEARCH = "recipes/jepa.yaml", "recipes/data.yaml", "recipes/fleet-search.yaml"
CHANGES = {"max_epochs": 4, "check_val_every_n_epoch": 2, "schedulers": ["channel_aware", "round_robin"]}
STATE = ("state_dict", "optimizer_states", "lr_schedulers", "global_step", "epoch")


@dataclass
class Case:
    """A command that is killed.

    Args:
        arguments: of the command, at first and again.
        look: reads the result as a user would; None where there is none (yet). It may not find half of one.
        before: makes what the command needs.
    """

    arguments: list[str]
    look: Callable[[], object]
    before: Callable[[], None] = lambda: None


def data_set() -> object:
    path = Path("data/cartpole")
    if not path.exists():
        return None
    metadata = read_metadata(path)
    contents = {file.name: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    return metadata["sha256"], sorted(contents), contents["contact_sheet.png"]


def run() -> object:
    """Checkpoint, model and log of a fit."""
    path = Path("runs/jepa")
    found = {}
    if (path / "checkpoints" / "last.ckpt").exists():
        checkpoint = torch.load(path / "checkpoints" / "last.ckpt", weights_only=True)
        found["checkpoint"] = {key: checkpoint[key] for key in STATE}
    if (path / "model").exists():
        entries.verify(path / "model")
        found["model"] = (path / "model" / entries.WEIGHTS).read_bytes()
        found["log"] = (path / "metrics.csv").read_text()
    return found or None


def search() -> object:
    path = Path("runs/fleet-search/search.json")
    if not path.exists():
        return None
    result = json.loads(path.read_text())
    del result["made_by"]
    return result


def entry() -> object:
    entries.verify(Path("checkpoints/tiny"))
    return Path(f"checkpoints/tiny/{entries.WEIGHTS}").read_bytes()


def two_models() -> None:
    """An entry of the zoo, and another model with its evaluation that is to take its place."""
    for seed, folder in ((1, "checkpoints/tiny"), (2, "runs/actor/model")):
        entries.save(tiny_controller.tiny(seed), folder)
    figures = {"model_sha256": entries.load("runs/actor/model").entry_sha256, "closed_loop": []}
    Path("runs/actor/evaluation").mkdir()
    Path("runs/actor/evaluation/evaluation.json").write_text(json.dumps(figures))


def collected() -> None:
    assert in_child(["collect", "--config", DATA]) == 0


CASES = {
    "collect": Case(["collect", "--config", DATA], data_set),
    "fit": Case(["fit", "--config", JEPA, "--ckpt_path", "last"], run, collected),
    "sweep": Case(["simulate", "--config", SEARCH], search),
    "export": Case(["export", "runs/actor", "tiny"], entry, two_models),
}


def start(arguments: list[str]) -> int:
    """Runs a command in a forked process, quietly, and gives its process id."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        log = os.open("log.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(log, 1)
        os.dup2(log, 2)
        status = cli.main(arguments)
    except SystemExit as exit_:
        status = exit_.code
    except BaseException as error:
        print(repr(error), file=sys.stderr, flush=True)
    finally:
        sys.stdout.flush()
        os._exit(status)


def in_child(arguments: list[str]) -> int:
    """Exit status of a command."""
    return os.waitstatus_to_exitcode(os.waitpid(start(arguments), 0)[1])


def killed(arguments: list[str], delay: float) -> bool:
    """Whether the kill came before the command ended."""
    child = start(arguments)
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in (0, -signal.SIGKILL), Path("log.txt").read_text()
    return status == -signal.SIGKILL


def same(first: object, second: object) -> bool:
    """Equality that looks into dicts, lists and tensors."""
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(same(first[key], second[key]) for key in first)
    if isinstance(first, (list, tuple)) and isinstance(second, (list, tuple)):
        return len(first) == len(second) and all(map(same, first, second))
    return torch.equal(first, second) if isinstance(first, torch.Tensor) else first == second


def try_case(name: str, case: Case, kills: int, home: Path) -> dict:
    """Kills one command ``kills`` times, each time from the start, and goes on after it."""
    origin = Path.cwd()
    prepared = shutil.copytree(home, home.parent / f"{name}-prepared")
    os.chdir(prepared)
    case.before()
    earlier = case.look()
    os.chdir(shutil.copytree(prepared, home.parent / f"{name}-undisturbed"))
    began = time.monotonic()
    assert in_child(case.arguments) == 0, Path("log.txt").read_text()
    duration = time.monotonic() - began
    expected = case.look()
    draw, moments, failures = random.Random(name), [], []
    tries = 0
    while len(moments) < kills and tries < 10 * kills + 10:
        tries += 1
        folder = shutil.copytree(prepared, home.parent / f"{name}-{tries}")
        os.chdir(folder)
        moment = draw.uniform(0, duration)
        if killed(case.arguments, moment):
            moments.append(moment)
            try:
                found = case.look()
                # a fit leaves checkpoints on its way: to read them is to find them whole
                assert name == "fit" or same(found, earlier) or same(found, expected), "half a result was left"
                done = name == "collect" and found is not None  # killed after its last word: it will not overwrite
                assert in_child(case.arguments) == (2 if done else 0), Path("log.txt").read_text()
                assert same(case.look(), expected), "the result differs"
            except Exception as error:
                failures.append(f"after {moment:.3f} s: {error!r}")
        os.chdir(home.parent)
        shutil.rmtree(folder)
    os.chdir(origin)
    return {
        "command": "tsjepa " + " ".join(case.arguments),
        "kills": len(moments),
        "survived": len(moments) - len(failures),
        "failures": failures,
        "undisturbed_seconds": round(duration, 3),
        "killed_after_seconds": [round(value, 3) for value in (min(moments), statistics.median(moments), max(moments))],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--commands", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--output", default="docs/results/faults.json")
    options = parser.parse_args()
    output = Path(options.output).resolve()
    output.parent.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "home"
        for name in tiny.NAMES:
            tiny.write(home, name, tiny.replace(tiny.shrink(tiny.load(name)), CHANGES))
        result = {"made_by": provenance(), "commands": {}}
        for name in options.commands:
            result["commands"][name] = try_case(name, CASES[name], options.kills, home)
            print(json.dumps({name: result["commands"][name]}, indent=1), flush=True)
            # after every command: an hour's kills are not lost with the last
            write_text(output, json.dumps(result, indent=1) + "\n")
    lost = [name for name, row in result["commands"].items() if row["survived"] < options.kills]
    sys.exit(f"not every kill was survived: {', '.join(lost)}" if lost else 0)


if __name__ == "__main__":
    main()
