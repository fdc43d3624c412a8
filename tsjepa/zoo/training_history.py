"""Which fits, on which data, led to a model: read from what the fits left beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

from tsjepa.data.storage import METADATA
from tsjepa.models import entries


def training_history(folder: Path) -> list[dict]:
    """The fits that led to the model in ``folder``, the first one first.

    Args:
        folder: of the model, in that of its run, whose config.yaml Lightning has written.

    Returns:
        For each its ``command`` (and ``commit`` and ``date``, where the fit recorded them), ``seed``, and ``data``, the
        path of its data set. An entry of the zoo brings its own history.
    """
    metrics, config_path = json.loads((folder / entries.METRICS).read_text()), folder.parent / "config.yaml"
    if "training" in metrics:
        return metrics["training"]
    if not config_path.is_file():
        return []
    config = yaml.safe_load(config_path.read_text())
    fit = metrics.get("made_by", {"command": f"tsjepa fit --config {config_path.as_posix()}"})
    fit = fit | {"seed": config.get("seed_everything"), "data": _value(config.get("data"), "path")}
    pretrained = _value(config.get("model"), "pretrained")
    try:
        before = entries.find(pretrained) if pretrained else folder
    except FileNotFoundError:
        before = folder
    return [*(training_history(before) if before.resolve() != folder.resolve() else []), fit]


def data_sets(history: list[dict]) -> list[dict]:
    """Sizes of the data sets that the fits read, as far as they still lie where they lay."""
    described = []
    for path in dict.fromkeys(fit["data"] for fit in history if fit["data"]):
        if (Path(path) / METADATA).is_file():
            metadata = json.loads((Path(path) / METADATA).read_text())
            kept = {key: metadata[key] for key in ("sampling_interval", "slots", "seed", "random_colors", "sha256")}
            episodes = {split: sizes["episodes"] for split, sizes in metadata["splits"].items()}
            described.append({"path": path, "episodes": episodes, **kept})
    return described


def _value(config: Any, key: str) -> str | None:
    """The first text under ``key``, however deep."""
    if not isinstance(config, dict):
        return None
    if isinstance(config.get(key), str):
        return config[key]
    return next((found for value in config.values() if (found := _value(value, key)) is not None), None)
