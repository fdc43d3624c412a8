"""Trains TS-JEPA and its actor by the shipped recipes, on part of the data and with a budget that all points share."""

from __future__ import annotations

import tempfile
from pathlib import Path

import yaml
from filelock import FileLock

from tsjepa.data.module import Trajectories
from tsjepa.paper.rows import command_rows, expert_embeddings, load, loop_rows
from tsjepa.support.recipes import find_recipe
from tsjepa.training.monitor import effective_rank
from tsjepa.training.run import run_lightning

FINISHES = ("CentreEmbedding", "RefinePredictor")  # callbacks of a recipe without which the loop is another one
FIELDS = ("seeds", "starts", "slots", "process_noise_std")


def trained_rows(point: dict, loops: list[dict]) -> list[dict]:
    """Trains the model of a point and closes loops with it.

    Args:
        point: ``jepa_recipe``, ``actor_recipe``, ``train_episodes``, ``actor_episodes``, ``training_seed``, the
            budget's ``jepa_steps``, ``predictor_steps`` and ``actor_steps``, and the FIELDS of the loops.
        loops: what differs from loop to loop: ``update_every``, ``loss``, and names that the rows carry.

    Returns:
        The rows of every loop; those with ``update_every`` 1 and nothing lost carry the command error and the
        effective rank of the embeddings besides.
    """
    with tempfile.TemporaryDirectory() as folder:
        model = train(point, Path(folder))
        load.cache_clear()  # a model of an earlier point may have had the same path
        common = {"model": str(model), "sends": "embedding", "codec": "fp32", "between": "predict"}
        common |= {name: point[name] for name in FIELDS}
        rows = []
        for loop in loops:
            new = loop_rows(common | loop)
            if loop["update_every"] == 1 and not loop.get("loss"):
                errors = command_rows(common | loop)
                ranks = [float(effective_rank(expert_embeddings(common, row["seed"])[0])) for row in new]
                new = [
                    row | error | {"effective_rank": rank} for row, error, rank in zip(new, errors, ranks, strict=True)
                ]
            rows += [loop | row for row in new]
    return rows


def train(point: dict, folder: Path) -> Path:
    """The folder of the trained controller; see :func:`trained_rows`."""
    jepa = {"data": {"init_args": {"episodes": point["train_episodes"]}}}
    fit(point["jepa_recipe"], jepa, folder / "jepa", point["jepa_steps"], point)
    actor = {
        "model": {"init_args": {"pretrained": str(folder / "jepa" / "model")}},
        "data": {"init_args": {"episodes": point["actor_episodes"], "splits": ["actor_train"]}},
    }
    fit(point["actor_recipe"], actor, folder / "actor", point["actor_steps"], point)
    return folder / "actor" / "model"


def fit(recipe: str, changes: dict, root: Path, steps: int, point: dict) -> None:
    """Runs a recipe as the command line does, cut to what makes the model: no validation, no logs, no checkpoints.

    Args:
        recipe: its path.
        changes: of the model and its data.
        root: folder of the result.
        steps: of the optimiser.
        point: of which the ``training_seed`` and the ``predictor_steps`` are taken.
    """
    shipped = yaml.safe_load(Path(find_recipe(recipe)).read_text())
    prepare(shipped["data"]["init_args"])
    changes["trainer"] = {
        "default_root_dir": str(root),
        "callbacks": finishes(shipped["trainer"]["callbacks"], point["predictor_steps"]),
        "max_epochs": -1,
        "max_steps": steps,
        "limit_val_batches": 0,
        "logger": False,
        "enable_checkpointing": False,
        "enable_progress_bar": False,
    }
    overlay = root.with_suffix(".yaml")
    overlay.write_text(yaml.safe_dump(changes))
    run_lightning(
        "fit", ["--config", recipe, "--config", str(overlay), "--seed_everything", str(point["training_seed"])]
    )


def finishes(callbacks: list[dict], predictor_steps: int) -> list[dict]:
    """Those of a recipe's callbacks that the loop needs, the predictor's with so many steps."""
    kept = []
    for callback in callbacks:
        name = callback["class_path"].rpartition(".")[2]
        if name in FINISHES:
            steps = {"steps": predictor_steps} if name == "RefinePredictor" else {}
            kept.append({**callback, "init_args": callback.get("init_args", {}) | steps})
    return kept


def prepare(data: dict) -> None:
    """Collects a recipe's data set where it is absent, by one process at a time: points may be spread over several."""
    path = Path(data["path"])
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path.with_name(f".{path.name}.figures.lock")):
        Trajectories(path=data["path"], collect=data["collect"]).prepare_data()
