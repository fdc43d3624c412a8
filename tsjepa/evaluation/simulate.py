"""``tsjepa simulate``: a fleet on one radio; a table, plots, a film, and how many devices each scheduler can serve."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor
from tqdm import tqdm

from tsjepa.envs import Radio
from tsjepa.envs.make import HOLD, ON_STATE
from tsjepa.evaluation import search as sizes_served
from tsjepa.evaluation.conditions import load_on, plant_of, warn_of_another_renderer
from tsjepa.evaluation.fleet_film import fleet_film
from tsjepa.evaluation.fleet_pictures import age_plot, capacity_plot, device_plot
from tsjepa.evaluation.fleet_summary import as_csv, bits_sent, device_rows, summary, table
from tsjepa.evaluation.metrics import normalized_score
from tsjepa.evaluation.recorded import record_runs
from tsjepa.evaluation.rollouts import Loop, optimal_scores, run
from tsjepa.evaluation.shown import shown_run
from tsjepa.models import Controller, entries, hub
from tsjepa.plants import Plant, describe_plant
from tsjepa.radio.schedulers import SchedulerFunction, get_scheduler, layers_of, name_of
from tsjepa.radio.traces import describe, read_trace
from tsjepa.support.checks import at_least
from tsjepa.support.files import write_json, write_text
from tsjepa.support.journal import Journal
from tsjepa.support.nearest import did_you_mean
from tsjepa.support.provenance import code_hash, provenance
from tsjepa.support.recording import check_recording


@dataclass(frozen=True)
class Experiment:
    """What all fleets of one command have in common.

    Args:
        loop: without a scheduler, of any number of devices.
        schedulers: by the name that they have in results.
        optimal: raw scores [seeds, largest I] of the normaliser with perfect feedback.
        made: how the results were made, for the record.
        folder: of the results.
    """

    loop: Loop
    schedulers: dict[str, SchedulerFunction | str]
    optimal: Tensor
    made: dict[str, Any]
    folder: Path

    def of(self, scheduler: str, num_devices: int) -> Loop:
        """The loop of one fleet."""
        return replace(self.loop, scheduler=self.schedulers[scheduler], num_devices=num_devices)


def simulate(
    num_devices: int | None = 40,
    schedulers: Sequence[str] = ("channel_aware", "round_robin"),
    controller: str = HOLD,
    radio: Radio = Radio(),  # noqa: B008 - frozen
    plant: Plant | None = None,
    slots: int = 100,
    frame_history: int = 2,
    seeds: int = 5,
    search_over: Sequence[int] = (),
    search_resolution: int = 1,
    acceptable_score: float = 0.74,
    output: str = "runs/fleet",
    video: bool = True,
    record: str | None = None,
    device: str = "cpu",
) -> dict:
    """Runs a fleet of plants on one radio under each scheduler, on the same plants and the same channels.

    Writes fleet.json, devices.csv, scores.png, ages.png, fleet.mp4 and fleet.gif for a fleet of ``num_devices``, and
    search.json and search.png where ``search_over`` is given. A search that was killed goes on where it was.

    Args:
        num_devices: I, or None for the search alone.
        schedulers: names in tsjepa.radio.SCHEDULERS, or import paths of functions of your own; in Python also the
            functions. The film shows the first two.
        controller: one of tsjepa.envs.make.ON_STATE, such as "hold" (the expert on the received state, its command held
            between updates), or a model by name or folder.
        radio: uplink and downlink.
        plant: the kind of machine; left out, the one that the model was trained on.
        slots: T.
        frame_history: slots up to step 0, the warm-up at rest; at least those of the model's stack.
        seeds: how many seeds of plants and channels, at least 2.
        search_over: fleet sizes, ascending, between which the largest acceptable one is searched for.
        search_resolution: devices between two sizes of which the search tries none between them; the crossing is then
            interpolated.
        acceptable_score: normalised score that the mean over the fleet has to keep.
        output: folder of the results.
        video: make the film.
        record: path of an ``.rrd`` file for the Rerun viewer, which shows the first seed of the fleet under every
            scheduler: pictures, beliefs, states, commands, ages, who sends. Needs ``pip install 'tsjepa[record]'``.
        device: where the model computes, such as cuda.

    Raises:
        ValueError: an argument that cannot be.
        FileNotFoundError: there is no such controller.
    """
    if num_devices is None and not search_over:
        raise ValueError("Nothing to do: give num_devices, search_over, or both.")
    if record is not None:
        check_recording(record)
        if num_devices is None:
            raise ValueError("A search is not recorded: give num_devices beside record.")
    at_least(2, seeds=seeds)
    at_least(1, slots=slots, frame_history=frame_history, search_resolution=search_resolution)
    if num_devices is not None:
        at_least(1, num_devices=num_devices)
        radio.check_fleet(num_devices)
    if search_over:
        sizes_served.check_sizes(search_over)
    if isinstance(schedulers, str) or not schedulers:
        raise ValueError("schedulers is a list of at least one name, such as [channel_aware, round_robin].")
    named = {name_of(scheduler): scheduler for scheduler in schedulers}
    if len(named) < len(schedulers):
        called = [name_of(scheduler) for scheduler in schedulers]
        raise ValueError(f"Of the schedulers {', '.join(called)} two have one name: leave one out, or give it another.")
    functions = [get_scheduler(scheduler) for scheduler in schedulers]
    model_or_name = load_controller(controller, device)
    machine = plant_for(model_or_name, plant)
    film = (video or record is not None) and num_devices is not None
    camera = machine.camera() if film or isinstance(model_or_name, Controller) else {}
    warn_of_another_renderer(camera, getattr(model_or_name, "metrics", None))
    sizes = [*search_over] if num_devices is None else [num_devices, *search_over]
    # the normaliser's plants start as the model's, whose stack may be longer
    frame_history = max(frame_history, getattr(model_or_name, "frame_history", 0))
    loop = Loop(machine, model_or_name, "none", max(sizes), slots, radio, frame_history)
    for scheduler in functions:
        # says now what does not fit together, and what a scheduler answers in its first slot
        replace(loop, scheduler=scheduler, num_devices=min(sizes)).env(0).reset()
    optimal = optimal_scores(loop, seeds)
    for best in optimal[:, : min(sizes)]:
        normalized_score(best, best)  # says now where scores cannot be normalised
    settings = {"controller": controller, "radio": asdict(radio), "plant": describe_plant(machine)}
    settings |= {"slots": slots, "frame_history": frame_history}
    made = {
        "made_by": provenance() | {"seeds": list(range(seeds))},
        "settings": settings,
        "camera": camera,
        "model_sha256": getattr(model_or_name, "entry_sha256", None),
        "optimal_policy": machine.normaliser,
        "acceptable_score": acceptable_score,
    }
    if radio.trace is not None:
        made["trace"] = trace_of(radio, machine.spec.slot, slots)
        print(f"The trace {radio.trace}: {made['trace']['describes']}")
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    experiment = Experiment(loop, named, optimal, made, folder)
    result = {}
    if num_devices is not None:
        result["fleet"] = one_fleet(experiment, num_devices, video, record)
    if search_over:
        layers = [layer for scheduler in functions for layer in layers_of(scheduler) if not isinstance(layer, partial)]
        result["search"] = search(experiment, search_over, code_hash(type(machine), *layers), search_resolution)
    print(f"Figures and plots are in {folder}.")
    return result


def trace_of(radio: Radio, slot: float, slots: int) -> dict[str, str]:
    """What is played: a sentence on its length, its stretching, its repetitions and its gaps, and the file's hash."""
    trace = read_trace(radio.trace)
    describes = describe(trace, slot, radio.trace_stretch, slots)
    return {"describes": describes, "sha256": hashlib.sha256(Path(radio.trace).read_bytes()).hexdigest()}


def load_controller(name: str, device: str = "cpu") -> str | Controller:
    """The controller that a recipe names, a model on ``device``.

    Raises:
        FileNotFoundError: there is none of this name.
        ValueError: it has no actor.
    """
    if name in ON_STATE:
        return name
    try:
        model = load_on(name, device)
    except FileNotFoundError as error:
        if Path(name).is_dir() or hub.is_address(name):  # it says what is wrong with them
            raise
        meant = did_you_mean(name, [*ON_STATE, *entries.names()])
        raise FileNotFoundError(
            f"There is no controller {name!r}{meant} (choose the folder of a model, or {', '.join(ON_STATE)}, or an "
            "entry that `tsjepa zoo` lists)."
        ) from error
    model.check_acts()
    return model


def plant_for(controller: str | Controller, plant: Plant | None) -> Plant:
    """The plant of a recipe, or the one that the model was trained on.

    Raises:
        ValueError: nobody names one.
    """
    found = plant_of(controller, plant) if isinstance(controller, Controller) else plant
    if found is None:
        raise ValueError(
            "A fleet needs a plant: give plant, a class_path such as tsjepa.plants.CartPole with its init_args."
        )
    return found


def one_fleet(experiment: Experiment, count: int, video: bool, record: str | None) -> dict:
    """The fleet of ``count`` devices under every scheduler, with its files."""
    optimal, folder = experiment.optimal[:, :count], experiment.folder
    runs, seen = {}, {}
    for scheduler in tqdm(experiment.schedulers, desc=f"{count} devices", unit="scheduler"):
        loop = experiment.of(scheduler, count)
        seen[scheduler] = shown_run(loop, 0)
        runs[scheduler] = [seen[scheduler].run, *(run(loop, seed) for seed in range(1, len(optimal)))]
    rows = [summary(scheduler, of_scheduler, optimal) for scheduler, of_scheduler in runs.items()]
    devices = [row for scheduler, of_scheduler in runs.items() for row in device_rows(scheduler, of_scheduler, optimal)]
    result = experiment.made | {"num_devices": count, "schedulers": rows}
    write_json(folder / "fleet.json", result, indent=1)
    write_text(folder / "devices.csv", as_csv(devices))
    device_plot(devices, folder / "scores.png")
    age_plot(rows, folder / "ages.png")
    if video:
        fleet_film(dict(list(seen.items())[:2]), experiment.loop.plant, folder)
    if record is not None:
        record_runs(record, seen, experiment.loop.plant, experiment.loop.controller)
    print(table(rows))
    return result


def search(experiment: Experiment, sizes: Sequence[int], code: str, resolution: int = 1) -> dict:
    """The largest acceptable fleet of every scheduler, with its files; ``code`` tells two states of the code apart."""
    made, folder, optimal = experiment.made, experiment.folder, experiment.optimal
    # the settings name a trace by its path, whatever the file holds
    depends_on = {key: made[key] for key in ("settings", "model_sha256", "optimal_policy", "trace") if key in made}
    depends_on["code"] = code
    journal = Journal(folder / "search.journal", depends_on)
    points = []

    def point(scheduler: str, count: int, seed: int) -> dict:
        outcome = run(experiment.of(scheduler, count), seed)
        return {
            "scheduler": scheduler,
            "num_devices": count,
            "seed": seed,
            "normalized_score": normalized_score(outcome.raw_score(), optimal[seed, :count]),
            "failed_share": float(outcome.failed().float().mean()),
            "mean_age": float(outcome.age.double().mean()),
            "delivery_rate": outcome.delivery_rate(),
            "utilisation": outcome.utilisation(),
            **bits_sent([outcome]),
        }

    def score(scheduler: str, count: int) -> list[float]:
        for seed in range(len(optimal)):
            key = f"{scheduler}, {count} devices, seed {seed}"
            if key not in journal.done:
                journal.add(key, point(scheduler, count, seed))
            points.append(journal.done[key])
        scores = [row["normalized_score"] for row in points[-len(optimal) :]]
        progress.update()
        progress.set_postfix_str(f"{scheduler}, {count} devices: {sizes_served.mean(scores):.3f}")
        return scores

    acceptable = made["acceptable_score"]
    with tqdm(desc="fleets", unit="fleet") as progress:
        curves = sizes_served.search(score, list(experiment.schedulers), sizes, acceptable, resolution)
    result = made | {"largest": sizes_served.largest(curves, acceptable), "points": points}
    write_json(folder / "search.json", result, indent=1)
    journal.path.unlink()
    capacity_plot(result, folder / "search.png")
    print(sizes_served.table(result["largest"]))
    return result
