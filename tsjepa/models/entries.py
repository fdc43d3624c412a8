"""The model zoo: folders of weights and configuration that load in one line and prove that they are whole.

An entry is ``config.yaml`` (class paths and arguments of the model's parts), ``model.safetensors`` (weights and
statistics), ``metrics.json`` (figures and how they were measured), ``README.md`` (model card) and ``manifest.json``
(SHA-256 of the others, the card excepted). Nothing in it is ever unpickled.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import torch
import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from tsjepa.models import hub
from tsjepa.support.description import build, describe
from tsjepa.support.files import exclusive, json_text, refuse_to_replace, replace_folder
from tsjepa.support.foreign import is_pointer
from tsjepa.support.nearest import did_you_mean
from tsjepa.support.spec import PlantSpec

FORMAT = 2
FILES = ("config.yaml", "model.safetensors", "metrics.json", "README.md", "manifest.json")
CONFIG, WEIGHTS, METRICS, CARD, MANIFEST = FILES
HASHED = (CONFIG, WEIGHTS, METRICS)
WEIGHT_DTYPES = {"float32": torch.float32, "float16": torch.float16}


class DamagedEntryError(ValueError):
    """A file of a zoo entry is missing or not what its manifest says."""


def zoo_folder() -> Path:
    """Where the shipped entries lie: inside an installed package, or at the top of a checkout."""
    packaged = Path(__file__).parent.parent / "checkpoints"
    return packaged if packaged.is_dir() else Path(__file__).parent.parent.parent / "checkpoints"


def names() -> list[str]:
    """Names of the shipped entries."""
    return sorted(path.parent.name for path in zoo_folder().glob(f"*/{MANIFEST}"))


def find(name_or_path: str | Path) -> Path:
    """Folder of an entry, by name, by path, or by the folder of the fit that has left it below ``model``.

    Raises:
        FileNotFoundError: there is neither such an entry nor such a folder, or the fit has not ended.
    """
    run = Path(name_or_path)
    if (run / "model" / MANIFEST).is_file():
        return run / "model"
    if (run / "checkpoints" / "last.ckpt").is_file() and not (run / MANIFEST).exists():
        raise FileNotFoundError(
            f"The fit in {run} has left no model: go on with it by the command that began it and --ckpt_path last."
        )
    for folder in (Path(name_or_path), zoo_folder() / str(name_or_path)):
        if (folder / CONFIG).exists() or (folder / MANIFEST).exists():
            return folder
    mend = did_you_mean(str(name_or_path), names()) or ": give the folder of an entry, or one that `tsjepa zoo` lists."
    raise FileNotFoundError(f"There is no model {str(name_or_path)!r}{mend}")


def fingerprint(folder: str | Path) -> str:
    """SHA-256 of an entry's manifest, which pins every file in it but the card."""
    return hashlib.sha256((Path(folder) / MANIFEST).read_bytes()).hexdigest()


def verify(folder: Path, sha256: str | None = None) -> None:
    """Re-hashes an entry.

    Args:
        folder: of the entry.
        sha256: what :func:`fingerprint` gave for the entry that is wanted; None trusts the manifest in the folder.

    Raises:
        DamagedEntryError: naming the first file that is missing or differs.
    """
    expected = digests(folder)
    if sha256 is not None and fingerprint(folder) != sha256.lower():
        raise DamagedEntryError(
            f"{folder / MANIFEST} has the SHA-256 {fingerprint(folder)}, not {sha256}: this is another entry, or "
            "another version; give the SHA-256 of this one, or fetch the entry anew."
        )
    for name, digest in expected.items():
        if hashlib.sha256(_content(folder / name)).hexdigest() != digest:
            raise DamagedEntryError(f"{folder / name} is not the file that the manifest names; fetch the entry anew.")


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of an entry's files as its manifest has them, by name.

    Raises:
        DamagedEntryError: the manifest is missing, unreadable, or a pointer of Git LFS.
    """
    content = _content(folder / MANIFEST)
    try:
        manifest = json.loads(content)
        return {name: manifest["sha256"][name] for name in HASHED}
    except (ValueError, KeyError, TypeError) as error:
        raise DamagedEntryError(f"{folder / MANIFEST} is unreadable; fetch the entry anew.") from error


def _content(path: Path) -> bytes:
    if not path.is_file():
        raise DamagedEntryError(f"{path} is missing; fetch the entry anew.")
    if is_pointer(path):
        raise DamagedEntryError(f"{path} is a pointer of Git LFS instead of the file itself: run `git lfs pull`.")
    return path.read_bytes()


def load(name_or_path: str | Path, sha256: str | None = None, trusted: bool = False) -> nn.Module:
    """Loads a model, ready to use on the CPU and in evaluation mode.

    Args:
        name_or_path: name of a shipped entry, the folder of one, or ``hf://owner/name[@revision]``, which fetches it
            from the Hugging Face Hub (see :mod:`tsjepa.models.hub`); nothing else is ever downloaded.
        sha256: :func:`fingerprint` of the entry, to accept this one only.
        trusted: import classes that are not this package's own.

    Returns:
        A controller with ``encode``, ``act``, ``predict`` and ``probe``, in float32. Its ``metrics``, ``card`` and
        ``plant`` are those of the entry, ``entry_sha256`` the entry's fingerprint.

    Raises:
        FileNotFoundError: no such entry.
        DamagedEntryError: a file is missing or has changed.
        ValueError: the entry is whole, but of a kind or with settings that this version does not know.
    """
    folder = _download(name_or_path) if hub.is_address(name_or_path) else find(name_or_path)
    verify(folder, sha256)
    config = _config(folder / CONFIG)
    model = build(config["model"], _part_of_a_model, trusted)
    weights = load_file(folder / WEIGHTS)
    own = model.state_dict()
    lacking = tuple(part for part in model.optional if not any(name.startswith(part) for name in weights))
    absent = {name: value for name, value in own.items() if name.startswith(lacking)}
    # a statistic of one number may be stored as a scalar
    shaped = {
        name: value.reshape(own[name].shape) if name in own and own[name].numel() == value.numel() else value
        for name, value in weights.items()
    }
    try:
        model.load_state_dict(absent | shaped)  # copies into float32
    except RuntimeError as error:
        raise ValueError(f"The weights in {folder / WEIGHTS} are not those of the model in {CONFIG}.") from error
    model.entry_sha256, model.plant = fingerprint(folder), config.get("plant")
    model.metrics = json.loads((folder / METRICS).read_text())
    card = folder / CARD
    model.card = card.read_text(encoding="utf-8", errors="replace") if card.is_file() else ""
    return model.eval().requires_grad_(False)


def _part_of_a_model(kind: type) -> bool:
    return issubclass(kind, (nn.Module, PlantSpec))


def _download(address: str | Path) -> Path:
    repository, revision = hub.parse(address)
    return hub.download(repository, FILES, revision)


def _config(path: Path) -> dict:
    config = yaml.safe_load(path.read_text())
    if not isinstance(config, dict) or config.get("format") != FORMAT or "model" not in config:
        found = config.get("format", 1) if isinstance(config, dict) else "none"
        raise ValueError(f"{path} has the format {found}; this version reads {FORMAT}: fetch the entry anew.")
    return config


def configuration(model: nn.Module) -> dict:
    """What an entry says of the classes, sizes and plant of ``model``.

    Raises:
        ValueError: a part of the model does not keep its arguments.
    """
    return {"format": FORMAT, "model": describe(model, _part_of_a_model), "plant": model.plant}


def check_replaceable(folder: Path) -> None:
    """Says whether :func:`save` may write ``folder``.

    Raises:
        FileExistsError: it holds something else than an entry.
    """
    refuse_to_replace(folder, "stored model", WEIGHTS, MANIFEST)  # others have the other files too


def save(
    model: nn.Module, folder: str | Path, metrics: dict | None = None, card: str = "", dtype: str = "float32"
) -> Path:
    """Writes an entry beside ``folder`` and renames it: a reader finds the old one or the new one, never half of one.

    Args:
        model: a controller, of whose parts each keeps its arguments (see :func:`tsjepa.support.description.describe`).
        folder: made, or replaced where it holds an earlier entry.
        metrics: figures for ``metrics.json``.
        card: text of the model card.
        dtype: of the weights, "float32" or "float16". Statistics (all buffers) stay in 32 bits, and so does a weight
            tensor with a value beyond the range of float16.

    Raises:
        ValueError: another dtype, a part of the model that cannot be described, or a weight or figure that is not
            finite; what was there stays.
        FileExistsError: ``folder`` holds something else, or another process is writing the same entry.
        OSError: no room, or no right to write; what was there stays.
    """
    if dtype not in WEIGHT_DTYPES:
        raise ValueError(f"Weights are stored as {' or '.join(WEIGHT_DTYPES)}, not as {dtype!r}.")
    folder = Path(folder)
    check_replaceable(folder)
    weights = _stored(model, WEIGHT_DTYPES[dtype])
    texts = {
        CONFIG: yaml.safe_dump(configuration(model), sort_keys=False),
        METRICS: json_text(folder / METRICS, metrics or {}, indent=2) + "\n",
        CARD: card,
    }
    with exclusive(folder):
        partial = folder.with_name(folder.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        try:
            _write(partial, texts, weights)
        except (OSError, SafetensorError) as error:
            shutil.rmtree(partial, ignore_errors=True)
            raise OSError(f"The model could not be written to {folder} ({error}); what was there is whole.") from error
        replace_folder(partial, folder)
    return folder


def _write(partial: Path, texts: dict[str, str], weights: dict[str, torch.Tensor]) -> None:
    for name, text in texts.items():
        (partial / name).write_text(text, encoding="utf-8")
    save_file(weights, partial / WEIGHTS)
    (partial / WEIGHTS).chmod(0o644)  # safetensors lets only the owner read
    digests = {name: hashlib.sha256((partial / name).read_bytes()).hexdigest() for name in HASHED}
    # no newline at its end: a manifest that is cut anywhere is no longer JSON
    (partial / MANIFEST).write_text(json.dumps({"sha256": digests}, indent=2))


def _stored(model: nn.Module, dtype: torch.dtype) -> dict[str, torch.Tensor]:
    """The tensors as they go to disk.

    Raises:
        ValueError: a weight is not finite. A statistic may be, of a part that nobody has fitted.
    """
    trained = {name for name, _ in model.named_parameters()}
    stored = {}
    for name, tensor in model.state_dict().items():
        tensor = tensor.detach().cpu().contiguous()
        if name in trained and not tensor.isfinite().all():
            raise ValueError(
                f"The model is not stored: its weight {name} is not finite; fit it at a lower learning rate."
            )
        if tensor.is_floating_point():
            tensor = tensor.float()
            narrow = tensor.to(dtype)
            tensor = narrow if name in trained and narrow.isfinite().all() else tensor
        stored[name] = tensor
    return stored
