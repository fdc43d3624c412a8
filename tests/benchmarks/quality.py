"""Seconds from an empty folder to a normalised score of 0.9 and of 0.95 with an update in every slot.

    python tests/benchmarks/quality.py --threads 2            # about twenty minutes on two idle cores

Each of the epoch numbers is a run of its own: in a new, empty folder the commands that a user would type collect the
data set and train TS-JEPA by recipes/jepa.yaml, train the actor by recipes/actor.yaml, and close the loop on the
starts of recipes/evaluate.yaml. The first two count, with every start of Python; the evaluation is timed beside them.
"""

import argparse
import json
import shutil
import tempfile
from pathlib import Path

from command import seconds_to_run
from report import publish

SCORES = (0.9, 0.95)
TARGET_SECONDS = 480


def train(epochs: int, threads: int, accelerator: str, folder: Path) -> dict:
    """Seconds of every command, and the score of what they have trained.

    Args:
        epochs: of TS-JEPA.
        threads: of torch.
        accelerator: what Lightning trains on; "auto" takes a GPU where there is one.
        folder: holds nothing, or recipes that replace the package's.
    """
    on = ("--trainer.accelerator", accelerator)
    commands = {
        "collect_and_fit": ("fit", "--config", "recipes/jepa.yaml", *on, "--trainer.max_epochs", str(epochs)),
        "fit_actor": ("fit", "--config", "recipes/actor.yaml", *on),
        "evaluate": (
            *("evaluate", "--config", "recipes/evaluate.yaml", "--model", "runs/actor/model"),
            *("--periods", "[1]", "--data", "null", "--video", "false"),
        ),
    }
    seconds = {name: seconds_to_run(folder, *words, threads=threads) for name, words in commands.items()}
    evaluation = json.loads((folder / "runs" / "evaluation" / "evaluation.json").read_text())
    ours = next(row for row in evaluation["closed_loop"] if row["controller"] == "TS-JEPA")
    return {
        "epochs": epochs,
        "seconds": seconds,
        "seconds_to_train": sum(seconds.values()) - seconds["evaluate"],
        "normalized_score": ours["normalized_score"],
        "interval_95": ours["interval_95"],
        "failures": ours["failures"],
        "starts": ours["starts"],
    }


def seconds_to(score: float, runs: list[dict]) -> float | None:
    """Of the fastest run that reaches ``score``; None where none does."""
    return min((run["seconds_to_train"] for run in runs if run["normalized_score"] >= score), default=None)


def measure(epochs: list[int], threads: int, accelerator: str, recipes: str | None) -> dict:
    """One run for each number of epochs; with ``recipes``, a folder, in the place of the package's own."""
    runs = []
    for number in epochs:
        with tempfile.TemporaryDirectory() as home:
            if recipes is not None:
                shutil.copytree(recipes, Path(home) / "recipes")
            runs.append(train(number, threads, accelerator, Path(home)))
        print(json.dumps(runs[-1]), flush=True)
    return {
        "threads": threads,
        "accelerator": device(accelerator),
        "runs": runs,
        "seconds_to_score": {str(score): seconds_to(score, runs) for score in SCORES},
        "target": {"score": SCORES[-1], "seconds": TARGET_SECONDS},
    }


def device(accelerator: str) -> str:
    """Name of what Lightning trains on."""
    import torch

    if accelerator != "cpu" and torch.cuda.is_available():
        return torch.cuda.get_device_name()
    return "cpu"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, nargs="+", default=[10, 20, 32], help="of TS-JEPA, one run each")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--accelerator", default="auto", choices=("auto", "cpu", "gpu"))
    parser.add_argument("--recipes", help="a folder of recipes to use instead of the package's")
    parser.add_argument("--output", default="docs/results/quality.json")
    options = parser.parse_args()
    publish(options.output, measure(options.epochs, options.threads, options.accelerator, options.recipes))


if __name__ == "__main__":
    main()
