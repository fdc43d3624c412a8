"""How long the data set takes to collect, and its frames per second beside nothing but the rendering.

    python tests/benchmarks/collection.py            # about two minutes on an idle machine

Every round runs the command twice, for the recipe's data set and for one of one trajectory a split, which costs what
every collection costs (Python, its imports, the GL context). Their difference in frames over their difference in
seconds is the rate that is set beside ``mjr_render`` and ``mjr_readPixels`` of whole still pictures in a loop (as in
camera.py), which takes its turn in between.
"""

import argparse
import tempfile
from pathlib import Path

import camera
import yaml
from command import seconds_to_run
from report import publish, spread
from turns import Contender


def frames_of(recipe: dict) -> int:
    """Frames of the data set that a recipe collects."""
    return sum(split["episodes"] for split in recipe["splits"].values()) * (recipe.get("slots", 100) + 1)


def least(recipe: dict) -> dict:
    """The recipe with one trajectory a split."""
    return recipe | {"splits": {name: split | {"episodes": 1} for name, split in recipe["splits"].items()}}


def seconds_to_collect(recipe: dict, folder: Path) -> float:
    """Wall time of the command, from an empty folder."""
    with tempfile.TemporaryDirectory(dir=folder) as home:
        (Path(home) / "recipe.yaml").write_text(yaml.safe_dump(recipe | {"path": "data"}))
        return seconds_to_run(Path(home), "collect", "--config", "recipe.yaml")


def measure(recipe_path: str, rounds: int, bare_frames: int) -> dict:
    """Whole collections, least ones and bare rendering in turn."""
    recipe = yaml.safe_load(Path(recipe_path).read_text())
    frames, few = frames_of(recipe), frames_of(least(recipe))
    if frames <= few:
        raise SystemExit(f"{recipe_path} has one trajectory a split, which leaves no rate to measure; give it more.")
    bare = Contender(camera.bare)
    whole, start, rendering = [], [], []
    with tempfile.TemporaryDirectory() as home:
        for _ in range(rounds):
            start.append(seconds_to_collect(least(recipe), Path(home)))
            rendering.append(bare.rate(bare_frames))
            whole.append(seconds_to_collect(recipe, Path(home)))
    bare.stop()
    rates = [(frames - few) / (long - short) for long, short in zip(whole, start, strict=True)]
    return {
        "recipe": recipe_path,
        "trajectories": sum(split["episodes"] for split in recipe["splits"].values()),
        "frames": frames,
        "seconds": spread(whole),
        "of_which_start_seconds": spread(start),
        "frames_per_second": {"collection": spread(rates), "bare": spread(rendering)},
        "collection_over_bare": spread([ours / theirs for ours, theirs in zip(rates, rendering, strict=True)]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", default="recipes/data.yaml")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--bare-frames", type=int, default=5000, help="a round")
    parser.add_argument("--output", default="docs/results/collection.json")
    options = parser.parse_args()
    publish(options.output, measure(options.recipe, options.rounds, options.bare_frames))


if __name__ == "__main__":
    main()
