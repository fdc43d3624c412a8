"""Trains TS-JEPA and its actor by the shipped recipes, on part of the data and with a budget that all points share."""

from __future__ import annotations

import tempfile
from pathlib import Path

import yaml
from tensordict import TensorDictBase

from tsjepa.data.module import Trajectories
from tsjepa.paper.rows import command_rows, expert_embeddings, load, loop_rows
from tsjepa.support.recipes import find_recipe
from tsjepa.training.imitation_data import ImitationPairs
from tsjepa.training.monitor import effective_rank
from tsjepa.training.run import run_lightning

KEPT = ("CentreEmbedding", "RefinePredictor", "FitProbe", "FitCodec", "ExportModel")  # callbacks that make the model
FIELDS = ("seeds", "starts", "slots", "process_noise_std")


class PartOfTrajectories(Trajectories):
    """The first so many training trajectories, for everything that a fit does with them.

    Args:
        train_episodes: how many.
        kwargs: see :class:`Trajectories`.
    """

    def __init__(self, train_episodes: int, **kwargs) -> None:
        super().__init__(**kwargs)
        self.part = {"train": train_episodes}

    def split(self, name: str) -> TensorDictBase:
        return super().split(name)[: self.part.get(name)]


class PartOfPairs(ImitationPairs):
    """The same for the actor.

    Args:
        train_episodes, actor_episodes: how many trajectories of either split.
        kwargs: see :class:`ImitationPairs`.
    """

    def __init__(self, train_episodes: int, actor_episodes: int, **kwargs) -> None:
        super().__init__(**kwargs)
        self.part = {"train": train_episodes, "actor_train": actor_episodes}

    def split(self, name: str) -> TensorDictBase:
        return super().split(name)[: self.part.get(name)]


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
    jepa = yaml.safe_load(Path(find_recipe(point["jepa_recipe"])).read_text())
    part = {"train_episodes": point["train_episodes"]}
    shorten(jepa, folder / "jepa", point["jepa_steps"], {"RefinePredictor": point["predictor_steps"]})
    use(jepa, PartOfTrajectories, part | {"seed": point["training_seed"]})
    fit(jepa, folder / "jepa.yaml", point["training_seed"])
    actor = yaml.safe_load(Path(find_recipe(point["actor_recipe"])).read_text())
    shorten(actor, folder / "actor", point["actor_steps"], {"FitProbe": 1})
    use(actor, PartOfPairs, part | {"actor_episodes": point["actor_episodes"], "seed": point["training_seed"]})
    actor["model"]["init_args"]["pretrained"] = str(folder / "jepa")
    fit(actor, folder / "actor.yaml", point["training_seed"])
    return folder / "actor"


def shorten(recipe: dict, model: Path, steps: int, callback_steps: dict[str, int]) -> None:
    """Cuts a recipe, in place, to what makes the model: no validation, no logs, no checkpoints."""
    callbacks = []
    for callback in recipe["trainer"]["callbacks"]:
        name = callback["class_path"].rpartition(".")[2]
        if name in KEPT:
            arguments = callback.get("init_args", {})
            arguments |= {"steps": callback_steps[name]} if name in callback_steps else {}
            arguments |= {"folder": str(model)} if name == "ExportModel" else {}
            callbacks.append({"class_path": callback["class_path"], "init_args": arguments})
    recipe["trainer"] |= {
        "callbacks": callbacks,
        "max_epochs": -1,
        "max_steps": steps,
        "limit_val_batches": 0,
        "logger": False,
        "enable_checkpointing": False,
        "enable_progress_bar": False,
        "default_root_dir": str(model.parent),
    }


def use(recipe: dict, data: type, arguments: dict) -> None:
    """Replaces the data module of a recipe, in place, by one that takes part of the data."""
    recipe["data"]["class_path"] = f"{data.__module__}.{data.__qualname__}"
    recipe["data"]["init_args"] |= arguments


def fit(recipe: dict, path: Path, seed: int) -> None:
    """Runs a recipe as the command line does; the data set is collected before, by one process at a time."""
    from filelock import FileLock

    arguments = recipe["data"]["init_args"]
    data = Path(arguments["path"])
    data.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(data.with_name(f".{data.name}.figures.lock")):
        Trajectories(path=arguments["path"], collect=arguments["collect"]).prepare_data()
    path.write_text(yaml.safe_dump(recipe | {"seed_everything": seed}))
    run_lightning("fit", ["--config", str(path)])
