"""The model zoo: folders of weights and configuration that load in one line and prove that they are whole.

An entry is ``config.yaml`` (sizes), ``model.safetensors`` (weights and statistics), ``metrics.json`` (figures and how
they were measured), ``README.md`` (model card) and ``manifest.json`` (SHA-256 of the others, the card excepted).
Nothing in it is ever unpickled.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tsjepa.models import SemanticController

CONFIG, WEIGHTS, METRICS, CARD, MANIFEST = (
    "config.yaml",
    "model.safetensors",
    "metrics.json",
    "README.md",
    "manifest.json",
)
HASHED = (CONFIG, WEIGHTS, METRICS)
OPTIONAL = ("decoder.", "code_")  # parts that an entry may lack; each says so when it is used


class DamagedEntryError(ValueError):
    """A file of a zoo entry is missing or not what its manifest says."""


def zoo_folder() -> Path:
    """Where the shipped entries lie: inside an installed package, or at the top of a checkout."""
    packaged = Path(__file__).parent / "checkpoints"
    return packaged if packaged.is_dir() else Path(__file__).parent.parent / "checkpoints"


def names() -> list[str]:
    """Names of the shipped entries."""
    return sorted(path.parent.name for path in zoo_folder().glob(f"*/{MANIFEST}"))


def find(name_or_path: str | Path) -> Path:
    """Folder of an entry, by name or by path.

    Raises:
        FileNotFoundError: there is neither such an entry nor such a folder.
    """
    for folder in (Path(name_or_path), zoo_folder() / str(name_or_path)):
        if (folder / CONFIG).exists() or (folder / MANIFEST).exists():
            return folder
    raise FileNotFoundError(
        f"There is no model {str(name_or_path)!r}: give the folder of an entry, or one of "
        f"{', '.join(names()) or '(none)'}."
    )


def verify(folder: Path) -> None:
    """Re-hashes an entry.

    Raises:
        DamagedEntryError: naming the first file that is missing or differs.
    """
    try:
        manifest = json.loads((folder / MANIFEST).read_text())
        expected = {name: manifest["sha256"][name] for name in HASHED}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DamagedEntryError(f"{folder / MANIFEST} is missing or unreadable; fetch the entry anew.") from error
    for name, digest in expected.items():
        path = folder / name
        if not path.is_file():
            raise DamagedEntryError(f"{path} is missing; fetch the entry anew.")
        if hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise DamagedEntryError(f"{path} is not the file that the manifest names; fetch the entry anew.")


def load(name_or_path: str | Path) -> SemanticController:
    """Loads a model, ready to use on the CPU and in evaluation mode.

    Args:
        name_or_path: name of a shipped entry, or the folder of one.

    Returns:
        A controller with ``encode``, ``predict``, ``act`` and ``probe``.

    Raises:
        FileNotFoundError: no such entry.
        DamagedEntryError: a file is missing or has changed.
    """
    import yaml
    from safetensors.torch import load_file

    from tsjepa.models import Architecture, SemanticController

    folder = find(name_or_path)
    verify(folder)
    config = yaml.safe_load((folder / CONFIG).read_text())
    unknown = set(config) - {field.name for field in fields(Architecture)}
    if unknown:
        raise ValueError(
            f"{folder / CONFIG} has settings that this version does not know: {', '.join(sorted(unknown))}."
        )
    config = {name: tuple(value) if isinstance(value, list) else value for name, value in config.items()}
    model = SemanticController(Architecture(**config))
    weights = {name: tensor.float() for name, tensor in load_file(folder / WEIGHTS).items()}
    absent = {name: value for name, value in model.state_dict().items() if name.startswith(OPTIONAL)}
    model.load_state_dict(absent | weights)
    return model.eval().requires_grad_(False)


def save(model: SemanticController, folder: str | Path, metrics: dict | None = None, card: str = "") -> Path:
    """Writes an entry beside ``folder`` and renames it: a reader finds the old one or the new one, never half of one.

    Args:
        model: what :func:`load` will give back; weights are stored in 16 bits where that loses nothing by their dtype.
        folder: replaced if it is there.
        metrics: figures for ``metrics.json``.
        card: text of the model card.
    """
    import torch
    import yaml
    from safetensors.torch import save_file

    folder = Path(folder)
    partial = folder.with_name(folder.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    config = {
        name: list(value) if isinstance(value, tuple) else value for name, value in asdict(model.architecture).items()
    }
    (partial / CONFIG).write_text(yaml.safe_dump(config, sort_keys=False))
    (partial / METRICS).write_text(json.dumps(metrics or {}, indent=2) + "\n")
    (partial / CARD).write_text(card)
    weights = {
        name: tensor.detach().cpu().to(torch.float32 if tensor.is_floating_point() else tensor.dtype).contiguous()
        for name, tensor in model.state_dict().items()
    }
    save_file(weights, partial / WEIGHTS)
    (partial / WEIGHTS).chmod(0o644)  # safetensors lets only the owner read
    digests = {name: hashlib.sha256((partial / name).read_bytes()).hexdigest() for name in HASHED}
    # no newline at its end: a manifest that is cut anywhere is no longer JSON
    (partial / MANIFEST).write_text(json.dumps({"sha256": digests}, indent=2))
    retired = folder.with_name(folder.name + ".retired")
    shutil.rmtree(retired, ignore_errors=True)
    if folder.exists():
        os.replace(folder, retired)
    os.replace(partial, folder)
    shutil.rmtree(retired, ignore_errors=True)
    return folder
