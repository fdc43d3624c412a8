"""Which fits, on which data, led to a model: read from what the fits left beside it."""

from __future__ import annotations

from pathlib import Path

import yaml

from tsjepa.data.storage import METADATA
from tsjepa.models import entries
from tsjepa.support.files import read_json

KEPT = ("plant", "camera", "slots", "seed", "sha256")  # of a data set's metadata


def training_history(folder: Path) -> list[dict]:
    """The fits that led to the model in ``folder``, the first one first.

    Args:
        folder: of the model, in that of its run, whose config.yaml Lightning has written.

    Returns:
        For each its ``command`` (and ``commit`` and ``date``, where the fit recorded them), ``seed``, and ``data``, the
        path of its data set. An entry of the zoo brings its own history.

    Raises:
        ValueError: a metrics.json is damaged.
    """
    fits: list[dict] = []
    seen: set[Path] = set()  # a run may have been trained anew, from what was made of it
    before: Path | None = folder
    while before is not None and before.resolve() not in seen:
        seen.add(before.resolve())
        metrics, config_path = read_json(before / entries.METRICS), before.parent / "config.yaml"
        if "training" in metrics:
            return [*metrics["training"], *fits]
        if not config_path.is_file():
            break
        config = yaml.safe_load(config_path.read_text())
        fit = metrics.get("made_by", {"command": f"tsjepa fit --config {config_path.as_posix()}"})
        arguments = {part: (config.get(part) or {}).get("init_args") or {} for part in ("data", "model")}
        fit = fit | {"seed": config.get("seed_everything"), "data": arguments["data"].get("path")}
        fits.insert(0, fit)
        before = _found(arguments["model"].get("pretrained"))
    return fits


def _found(pretrained: str | None) -> Path | None:
    try:
        return entries.find(pretrained) if pretrained else None
    except FileNotFoundError:
        return None


def data_sets(history: list[dict]) -> list[dict]:
    """Sizes of the data sets that the fits read, as far as they still lie where they lay."""
    described = []
    for path in dict.fromkeys(fit["data"] for fit in history if fit["data"]):
        if (Path(path) / METADATA).is_file():
            metadata = read_json(Path(path) / METADATA)
            kept = {key: metadata[key] for key in KEPT if key in metadata}
            episodes = {split: sizes["episodes"] for split, sizes in metadata["splits"].items()}
            described.append({"path": path, "episodes": episodes, **kept})
    return described
