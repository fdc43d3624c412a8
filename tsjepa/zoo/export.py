"""``tsjepa export RUN NAME``: a trained model, with its evaluation and its history, becomes an entry of the zoo."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path

from tsjepa.evaluation.evaluate import evaluate
from tsjepa.models import AutoencoderController, Controller, entries
from tsjepa.support.files import read_json
from tsjepa.zoo.card import card
from tsjepa.zoo.training_history import data_sets, training_history
from tsjepa.zoo.verify import rescore


def export(
    run: str,
    name: str,
    evaluation: str | None = None,
    folder: str = "checkpoints",
    half: bool = False,
    trained_with: str = "",
    training_seeds: str | None = None,
    decoder: bool = True,
) -> dict:
    """Writes ``folder/name``: the weights of a run, how they score, how they were trained, and a model card.

    Args:
        run: folder of a fit, such as runs/actor, or of a model.
        name: of the entry.
        evaluation: what ``tsjepa evaluate`` wrote about this very model; by default evaluation/evaluation.json in the
            folder of the run, which is made where it is missing or about other weights (some minutes).
        folder: of the zoo.
        half: store weights in 16 bits, if the scores stay within their intervals.
        trained_with: words about the training for the card and metrics.json.
        training_seeds: what ``tsjepa zoo train`` wrote about several training seeds, for the same.
        decoder: keep what draws a belief for an onlooker; False saves up to a megabyte.

    Returns:
        ``entry``, the folder.

    Raises:
        ValueError: a name with folders, a model without an actor, an evaluation of other weights, a damaged file, or
            scores that 16 bits change.
        FileNotFoundError: there is no such run or evaluation.
        FileExistsError: the folder holds something else than an entry.
    """
    if name in ("", "..") or Path(name).name != name:
        raise ValueError(f"{name!r} is no name of an entry: leave out folders, which --folder gives.")
    entries.check_replaceable(Path(folder) / name)  # before what takes minutes
    source = entries.find(run)
    model = entries.load(source)
    model.check_acts()
    if not decoder and isinstance(model, AutoencoderController):
        raise ValueError("An autoencoder acts on what its decoder draws: leave decoder at true.")
    history = training_history(source)
    metrics = evaluation_of(model, source, evaluation, history)
    metrics |= {"training": history, "data_sets": data_sets(history), "trained_with": trained_with}
    if not decoder:
        model.decoder = None
    if training_seeds is not None:
        metrics["training_seeds"] = read_json(training_seeds)
    metrics["weights"] = {
        "dtype": "float16" if half else "float32",
        "parameters": sum(parameter.numel() for parameter in model.parameters()),
    }
    if half:
        metrics["weights"]["scored_again"] = checked_in_half(model, name, metrics)
    entry = entries.save(model, Path(folder) / name, metrics, card(name, model, metrics), metrics["weights"]["dtype"])
    print(f"{name} written to {entry}.")
    return {"entry": str(entry)}


def evaluation_of(model: Controller, source: Path, evaluation: str | None, history: list[dict]) -> dict:
    """The figures of ``model``, measured now unless they are there."""
    path = Path(evaluation) if evaluation else source.parent / "evaluation" / "evaluation.json"
    figures = read_json(path) if path.is_file() else {}
    if figures.get("model_sha256") == model.entry_sha256:
        return figures
    if evaluation and not figures:
        raise FileNotFoundError(f"There is no evaluation {path}: leave --evaluation out, and it is made.")
    if evaluation:
        raise ValueError(
            f"{path} is not about the weights in {source}: leave --evaluation out, and they are evaluated."
        )
    data = [described["path"] for described in data_sets(history)]
    print(
        f"{source} is evaluated first{'' if data else ', in closed loop only: its data set is not here'}.", flush=True
    )
    return evaluate(str(source), output=str(path.parent), data=data[-1] if data else None)


def checked_in_half(model: Controller, name: str, metrics: dict) -> list[dict]:
    """Scores the weights as 16 bits hold them.

    Raises:
        ValueError: a score leaves the interval of its evaluation.
    """
    with tempfile.TemporaryDirectory() as folder:
        rounded = entries.load(entries.save(model, Path(folder) / name, metrics, dtype="float16"))
    checks = rescore(rounded, name)
    if not all(check.passed for check in checks):
        raise ValueError(f"16 bits are too few for {name} ({'; '.join(map(str, checks))}): leave --half out.")
    return [asdict(check) for check in checks]
