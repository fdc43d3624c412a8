"""A figure's sweep: what is missing is evaluated and recorded point by point, so that it can be interrupted."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from types import ModuleType

from tqdm import tqdm

from tsjepa.evaluation.metrics import interval
from tsjepa.models import entries
from tsjepa.paper import store
from tsjepa.paper.launchers import launch
from tsjepa.radio.schedulers import get_scheduler
from tsjepa.support.files import exclusive
from tsjepa.support.provenance import code_hash, provenance
from tsjepa.support.recipes import find_recipe

HASH_DIGITS = 12
SLACK = 1e-3  # relative; what another processor's arithmetic may change where the interval is narrower


def run_sweep(
    module: ModuleType, points: list[dict], folder: str | Path, launcher: str = "serial", workers: int = 2
) -> list[dict]:
    """Evaluates the points that are not recorded yet, or were by other weights, recipes or code; returns all records.

    The file follows the sweep: points that it no longer has are dropped. Points whose model the zoo lacks are left out
    and named in one sentence.

    Args:
        module: of the figure.
        points: of the sweep, in the order of the file.
        folder: of the results.
        launcher, workers: see :func:`tsjepa.paper.launchers.launch`.

    Raises:
        ValueError: a scheduler that there is not, or that must not be imported.
        FileExistsError: another process runs the same sweep into the same folder.
    """
    with exclusive(Path(folder) / module.__name__.rpartition(".")[2]):
        return _run(module, points, folder, launcher, workers)


def _run(module: ModuleType, points: list[dict], folder: str | Path, launcher: str, workers: int) -> list[dict]:
    figure, code = module.__name__.rpartition(".")[2], code_hash(module)[:HASH_DIGITS]
    recorded = {store.key(record["point"]): record for record in store.read(folder, figure)}
    keys = [store.key(point) for point in points]
    stale = len(set(recorded) - set(keys))
    recorded = {key: recorded[key] for key in keys if key in recorded}
    if stale:
        print(f"{figure}: {stale} recorded points are not in this sweep and are dropped.")
        store.write(folder, figure, list(recorded.values()))
    missing = sorted({model for point in points for model in models_of(point) if weights_of(model) is None})
    if missing:
        print(f"{figure}: the zoo has no {', '.join(missing)} yet; the points that need it are left out.")
    todo = [
        point
        for key, point in zip(keys, points, strict=True)
        if not set(models_of(point)) & set(missing)
        and (key not in recorded or made_of(recorded[key]) != (code, all_weights(point)))
    ]
    for scheduler in {point["scheduler"] for point in todo if "scheduler" in point}:
        get_scheduler(scheduler)  # says now, and not after the points before it, what cannot be imported
    origin, weights = provenance(), [all_weights(point) for point in todo]
    outcomes = launch(module.__name__, todo, launcher, workers)
    for index, (rows, seconds) in tqdm(outcomes, desc=figure, total=len(todo), unit="point"):
        recorded[store.key(todo[index])] = {
            "point": todo[index],
            "rows": store.rounded(rows),
            "seconds": round(seconds, 1),
            "weights": weights[index],
            "code": code,
            "made_by": origin,
        }
        store.write(folder, figure, [recorded[key] for key in keys if key in recorded])
    return [recorded[key] for key in keys if key in recorded]


def made_of(record: dict) -> tuple[str | None, dict]:
    """What decides a recorded point's rows: the code (None in a record that does not say) and the weights."""
    return record.get("code"), record["weights"]


def models_of(point: dict) -> list[str]:
    """Entries of the zoo that a point uses: its ``model``, unless that is None (the expert on the true state)."""
    return [point["model"]] if point.get("model") else []


def weights_of(model: str) -> str | None:
    """First digits of the hash of an entry's weights; None where there is no such entry."""
    try:
        return entries.digests(entries.find(model))[entries.WEIGHTS][:HASH_DIGITS]
    except FileNotFoundError:
        return None


def all_weights(point: dict) -> dict[str, str | None]:
    """The weights that a point is evaluated with, or the recipes that it trains by: first digits of their hashes."""
    recipes = [point[name] for name in ("jepa_recipe", "actor_recipe") if name in point]
    digests = {name: sha256(Path(find_recipe(name)).read_bytes()).hexdigest()[:HASH_DIGITS] for name in recipes}
    return {model: weights_of(model) for model in models_of(point)} | digests


def check(module: ModuleType, records: list[dict], launcher: str = "serial") -> list[dict]:
    """Evaluates the quickest recorded point again; one row per measure: recorded interval, value now, agreement.

    Points that were recorded with other weights or recipes than there are now are left out.
    """
    able = [record for record in records if record["weights"] == all_weights(record["point"])]
    if not able:
        return []
    record = min(able, key=lambda record: record["seconds"])
    ((_, (rows, _)),) = launch(module.__name__, [record["point"]], launcher, 1)
    answer = []
    for measure in module.MEASURES:
        before, now = values(record["rows"], measure), values(store.rounded(rows), measure)
        if not before:
            continue
        mean, half = interval(before) if len(before) > 1 else (before[0], 0.0)
        value = sum(now) / len(now)
        answer.append(
            {
                "point": record["point"],
                "measure": measure,
                "recorded": mean,
                "interval_95": half,
                "now": value,
                "agrees": abs(value - mean) <= max(half, SLACK * abs(mean)),
            }
        )
    return answer


def values(rows: list[dict], measure: str) -> list[float]:
    """A measure of the rows that have it."""
    return [row[measure] for row in rows if row.get(measure) is not None]
