"""``tsjepa simulate``: a fleet on one radio; a table, plots, a film, and how many devices each scheduler can serve."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

from tsjepa.envs.settings import Plants, Radio
from tsjepa.envs.update_codec import fitted_codec
from tsjepa.evaluation import fleet_search
from tsjepa.evaluation.fleet import HOLD, LINEAR, FleetRun, check_scheduler, optimal_scores, run_fleet
from tsjepa.evaluation.fleet_film import fleet_film
from tsjepa.evaluation.fleet_pictures import age_plot, capacity_plot, device_plot
from tsjepa.evaluation.metrics import interval, normalized_score
from tsjepa.support.files import write_text
from tsjepa.support.journal import Journal
from tsjepa.support.provenance import provenance


def simulate(
    num_devices: int | None = 40,
    schedulers: Sequence[str] = ("channel_aware", "round_robin"),
    controller: str = HOLD,
    radio: Radio = Radio(),  # noqa: B008 - frozen
    plants: Plants = Plants(),  # noqa: B008 - frozen
    seeds: int = 5,
    search_over: Sequence[int] = (),
    acceptable_score: float = 0.74,
    output: str = "runs/fleet",
    video: bool = True,
) -> dict:
    """Runs a fleet of cart-poles on one radio under each scheduler, on the same plants and the same channels.

    Writes fleet.json, devices.csv, scores.png, ages.png, fleet.mp4 and fleet.gif for a fleet of ``num_devices``, and
    search.json and search.png where ``search_over`` is given. A search that was killed goes on where it was.

    Args:
        num_devices: I, or None for the search alone.
        schedulers: names in tsjepa.radio.SCHEDULERS; the film shows the first two.
        controller: "hold" (the expert on the received state, its command held between updates), "linear" (the expert
            on a state that the linearised plant predicts between updates), or a model by name or folder.
        radio: the uplink.
        plants: the cart-poles.
        seeds: how many seeds of plants and channels, at least 2.
        search_over: fleet sizes, ascending, between which the largest acceptable one is searched for.
        acceptable_score: normalised score that the mean over the fleet has to keep.
        output: folder of the results.
        video: make the film.
    """
    if num_devices is None and not search_over:
        raise ValueError("Nothing to do: give num_devices, search_over, or both.")
    if seeds < 2:
        raise ValueError(f"seeds is {seeds}; an interval needs at least 2.")
    if search_over:
        fleet_search.check_sizes(search_over)
    if isinstance(schedulers, str) or not schedulers:
        raise ValueError("schedulers is a list of at least one name, such as [channel_aware, round_robin].")
    for scheduler in schedulers:
        check_scheduler(scheduler)
    brain = load_controller(controller, plants)
    codec = fitted_codec(radio.codec, None if isinstance(brain, str) else brain)
    sizes = [*search_over] if num_devices is None else [num_devices, *search_over]
    best, optimal = optimal_scores(plants, seeds, max(sizes))
    if not optimal[:, : min(sizes)].sum(1).all():
        raise ValueError(
            f"For some seed nobody is in the box within {plants.slots} slots even with perfect feedback, so scores "
            "cannot be normalised; raise plants.slots or the number of devices."
        )

    def run(scheduler: str, count: int, seed: int) -> FleetRun:
        return run_fleet(count, scheduler, seed, plants, radio, codec, brain)

    made = {
        "made_by": provenance() | {"seeds": list(range(seeds))},
        "settings": {"controller": controller, "radio": asdict(radio), "plants": asdict(plants)},
        "optimal_policy": best,
        "acceptable_score": acceptable_score,
    }
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    result = {}
    if num_devices is not None:
        result["fleet"] = made | _one_fleet(run, schedulers, num_devices, optimal, folder, video)
        write_text(folder / "fleet.json", json.dumps(result["fleet"], indent=1) + "\n")
    if search_over:
        depends_on = {
            **made["settings"],
            "commit": made["made_by"]["commit"],
            "model": getattr(brain, "entry_sha256", None),
        }
        journal = Journal(folder / "search.journal", depends_on)
        result["search"] = made | _search(run, schedulers, search_over, optimal, acceptable_score, journal)
        write_text(folder / "search.json", json.dumps(result["search"], indent=1) + "\n")
        journal.path.unlink()
        capacity_plot(result["search"], folder / "search.png")
        print(fleet_search.table(result["search"]["largest"]))
    print(f"Figures and plots are in {folder}.")
    return result


def load_controller(name: str, plants: Plants):
    """The controller that a recipe names: "hold", "linear", or a model of the zoo that fits the plants."""
    if name in (HOLD, LINEAR):
        return name
    import tsjepa

    model = tsjepa.load(name)
    if model.spec.slot != plants.sampling_interval:
        raise ValueError(
            f"The model {name!r} was trained at {model.spec.slot} s per slot, plants."
            f"sampling_interval is {plants.sampling_interval}: make them equal."
        )
    if model.frame_history > plants.frame_history:
        raise ValueError(f"The model {name!r} needs plants.frame_history of {model.frame_history}.")
    return model


def _one_fleet(run, schedulers: Sequence[str], count: int, optimal: Tensor, folder: Path, video: bool) -> dict:
    seeds, best = range(len(optimal)), optimal[:, :count]
    runs = {
        scheduler: [run(scheduler, count, seed) for seed in seeds]
        for scheduler in tqdm(schedulers, desc=f"{count} devices", unit="scheduler")
    }
    rows = [summary(scheduler, fleet_runs, best) for scheduler, fleet_runs in runs.items()]
    devices = [row for scheduler, fleet_runs in runs.items() for row in device_rows(scheduler, fleet_runs, best)]
    write_text(folder / "devices.csv", _csv(devices))
    device_plot(devices, folder / "scores.png")
    age_plot(rows, folder / "ages.png")
    if video:
        fleet_film({scheduler: fleet_runs[0] for scheduler, fleet_runs in list(runs.items())[:2]}, folder)
    print(table(rows))
    return {"num_devices": count, "schedulers": rows}


def summary(scheduler: str, runs: list[FleetRun], optimal: Tensor) -> dict:
    """One row of the table: a scheduler over all seeds. ``age_counts[h - 1]`` counts the device-slots of age h."""
    scores = [normalized_score(run.loop.raw_score(), best) for run, best in zip(runs, optimal, strict=True)]
    mean, half = interval(scores)
    ages = torch.stack([run.age for run in runs])
    return {
        "scheduler": scheduler,
        "normalized_score": mean,
        "interval_95": half,
        "per_seed": scores,
        "failed_share": _mean(runs, lambda run: run.loop.failed()),
        "mean_age": float(ages.double().mean()),
        "age_95_percentile": float(ages.double().quantile(0.95)),
        "delivery_rate": sum(run.delivery_rate() for run in runs) / len(runs),
        "utilisation": sum(run.utilisation() for run in runs) / len(runs),
        "bits_per_device_and_slot": _mean(runs, lambda run: run.payload_bits),
        "age_counts": torch.bincount(ages.flatten() - 1).tolist(),
    }


def device_rows(scheduler: str, runs: list[FleetRun], optimal: Tensor) -> list[dict]:
    """One row per device and seed."""
    rows = []
    for seed, (run, best) in enumerate(zip(runs, optimal.tolist(), strict=True)):
        columns = {
            "raw_score": run.loop.raw_score(),
            "failed": run.loop.failed().long(),
            "mean_age": run.age.double().mean(0),
            "transmissions": run.scheduled.sum(0),
            "deliveries": run.delivered.sum(0),
            "bits": run.payload_bits.sum(0),
        }
        lists = {name: [round(value, 6) for value in column.tolist()] for name, column in columns.items()}
        for device, perfect in enumerate(best):
            row = {name: values[device] for name, values in lists.items()}
            rows.append(
                {"scheduler": scheduler, "seed": seed, "device": device, "perfect_feedback": round(perfect, 6)} | row
            )
    return rows


def _search(
    run, schedulers: Sequence[str], sizes: Sequence[int], optimal: Tensor, acceptable: float, journal: Journal
) -> dict:
    points = []

    def point(scheduler: str, count: int, seed: int) -> dict:
        fleet_run = run(scheduler, count, seed)
        return {
            "scheduler": scheduler,
            "num_devices": count,
            "seed": seed,
            "normalized_score": normalized_score(fleet_run.loop.raw_score(), optimal[seed, :count]),
            "failed_share": float(fleet_run.loop.failed().float().mean()),
            "mean_age": float(fleet_run.age.double().mean()),
            "delivery_rate": fleet_run.delivery_rate(),
            "utilisation": fleet_run.utilisation(),
        }

    def score(scheduler: str, count: int) -> list[float]:
        for seed in range(len(optimal)):
            key = f"{scheduler}, {count} devices, seed {seed}"
            if key not in journal.done:
                journal.add(key, point(scheduler, count, seed))
            points.append(journal.done[key])
        scores = [row["normalized_score"] for row in points[-len(optimal) :]]
        progress.update()
        progress.set_postfix_str(f"{scheduler}, {count} devices: {fleet_search.mean(scores):.3f}")
        return scores

    with tqdm(desc="fleets", unit="fleet") as progress:
        curves = fleet_search.search(score, schedulers, sizes, acceptable)
    return {"largest": fleet_search.largest(curves, acceptable), "points": points}


def table(rows: list[dict]) -> str:
    """The rows as aligned text."""
    lines = [
        f"{'scheduler':<24}{'score':>15}{'failed':>9}{'age':>7}{'age 95 %':>10}{'delivered':>11}{'used':>7}"
        f"{'bit/device/slot':>17}"
    ]
    for row in rows:
        lines.append(
            f"{row['scheduler']:<24}{row['normalized_score']:>7.3f} ± {row['interval_95']:.3f}"
            f"{row['failed_share']:>9.1%}{row['mean_age']:>7.2f}{row['age_95_percentile']:>10.0f}{row['delivery_rate']:>11.1%}"
            f"{row['utilisation']:>7.0%}{row['bits_per_device_and_slot']:>17.1f}"
        )
    return "\n".join(lines)


def _mean(runs: list[FleetRun], values) -> float:
    return float(torch.stack([values(run).double() for run in runs]).mean())


def _csv(rows: list[dict]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
