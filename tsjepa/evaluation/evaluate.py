"""``tsjepa evaluate``: one controller in closed loop beside its baselines; table, plots, film and raw figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor
from tqdm import tqdm

from tsjepa.envs.make import EXACT, HOLD, LOSSLESS, ZERO, at_weights, state_is_physics
from tsjepa.evaluation.conditions import SEEDS, held_out_loop, load_on, plant_of, warn_of_another_renderer
from tsjepa.evaluation.films import draws, look_inside
from tsjepa.evaluation.metrics import Run
from tsjepa.evaluation.open_loop import fitting_metadata, open_loop_metrics
from tsjepa.evaluation.pictures import horizon_plot, loop_plot
from tsjepa.evaluation.recorded import record_runs
from tsjepa.evaluation.rollouts import ONCE, Loop, every, perfect_feedback, run
from tsjepa.evaluation.shown import shown_run
from tsjepa.evaluation.summary import score_by_slot, summary, table, watched_figures
from tsjepa.models import Controller
from tsjepa.plants import Plant, describe_plant
from tsjepa.support.checks import at_least, within
from tsjepa.support.files import write_json
from tsjepa.support.provenance import machine as computer
from tsjepa.support.provenance import provenance
from tsjepa.support.recording import check_recording

LABELS = {"tsjepa": "TS-JEPA"}  # by kind of model; the others are called by their kind
NO_PLANT = "Closed loops are left out, because they need a plant and this model was trained on a recording."
NO_ACTOR = "Closed loops and the command error are left out, because this model has no actor yet."
NO_DATA = "Command error on trajectories, probe error and prediction skill are left out, because no data set is given."


def evaluate(
    model: str,
    plant: Plant | None = None,
    output: str = "runs/evaluation",
    data: str | None = None,
    periods: Sequence[int] = (1, 2, 5, 10, 20, ONCE),
    seeds: int | None = None,
    first_seed: int | None = None,
    starts_per_seed: int | None = None,
    slots: int | None = None,
    frame_history: int | None = None,
    process_noise_std: float | None = None,
    blend: float = 1.0,
    codec: str = "fp32",
    video: bool = True,
    record: str | None = None,
    device: str = "cpu",
) -> dict:
    """Closes the loop on held-out starts with an update every P slots and prints how each controller did.

    What is left out of plant, seeds, starts, slots, history and noise is as in the model's own figures, so that they
    are measured again.

    Args:
        model: name or folder of a zoo entry.
        plant: the machine; the one that the model was trained on if left out. A model of a recording has none and is
            evaluated on data alone.
        output: folder for ``evaluation.json``, the plots ``score.png`` and (with a period of 0) ``horizon.png``, and
            what embeddings hold: the film ``loop.mp4`` and the still picture ``inside.png``.
        data: data set whose test split gives command error, probe error and prediction skill.
        periods: slots between updates; 0 means once, at the first slot.
        seeds: sets of starts, at least 2; else 5.
        first_seed: number of the first set, else 0; other numbers are other starts. Recipes were chosen on those from 0
            on, so that figures which nobody has chosen by come from a high one.
        starts_per_seed: starts in each; else 20.
        slots: length of a run; else 100.
        frame_history: slots up to step 0, the warm-up at rest; at least those of the model's stack. Models of different
            stacks meet the same starts with the longest one's.
        process_noise_std: standard deviation of the noise that the plant adds after every slot.
        blend: how much of a received embedding enters the belief; 1 replaces the prediction.
        codec: how an update is sent, see :class:`tsjepa.envs.Radio`; integer codecs need ranges that travel with the
            model.
        video: write the film and the still picture.
        record: path of an ``.rrd`` file for the Rerun viewer, which shows the film's start at every period: pictures,
            beliefs, states, commands, ages, when it sends. Needs ``pip install 'tsjepa[record]'``.
        device: where the model computes, such as cuda.

    Raises:
        ValueError: an argument that cannot be, data of another machine, neither a plant nor data, or neither an actor
            nor data.
        FileNotFoundError: there is no such model or data set.
    """
    if not periods:
        raise ValueError("periods is empty; give at least one, such as [1, 5, 10].")
    at_least(0, **{f"periods[{i}]": period for i, period in enumerate(periods)})
    within(0, 1, blend=blend)
    if record is not None:
        check_recording(record)
    controller = load_on(model, device)
    metadata = fitting_metadata(controller, data) if data else None
    if not controller.acts and not data:
        controller.check_acts()
    machine = plant_of(controller, plant, process_noise_std) if controller.acts else None
    if machine is None and record is not None:
        raise ValueError(f"The model {model} has no plant or no actor: record needs a plant whose loop it can show.")
    if machine is None and not data:
        raise ValueError(f"The model {model} was trained on a recording: give --data to evaluate it, or a plant.")
    result = {"made_by": provenance(), "machine": computer(), "model": model, "model_sha256": controller.entry_sha256}
    loop = None
    if machine is None:
        print(NO_PLANT if controller.acts else NO_ACTOR)
    else:
        loop = held_out_loop(controller, machine, starts_per_seed, slots, frame_history, blend, codec)
        of = seeds_of(controller, seeds, first_seed)
        camera = machine.camera()
        warn_of_another_renderer(camera, controller.metrics, metadata)
        result |= {"plant": describe_plant(machine), "camera": camera, "device": device}
        result |= closed_loops(loop, of, periods)
    if data:
        result["open_loop"] = open_loop_metrics(controller, data)
    else:
        print(NO_DATA)
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "evaluation.json", result)
    print(table(result))
    if loop is not None:
        pictures(loop, result, folder, video)
        if record is not None:
            runs = {after(period): shown_run(every(one_start(loop), period), of.stop) for period in periods}
            record_runs(record, runs, machine, controller)
    print(f"{'The figures' if loop is None else 'Figures, plots and film'} are in {folder}.")
    return result


def seeds_of(model: Controller, count: int | None, first: int | None) -> range:
    """Numbers of the sets of starts; what is None is as in the model's figures, else the first ones."""
    known = model.metrics.get("seeds", range(SEEDS))
    count, first = len(known) if count is None else count, known[0] if first is None else first
    at_least(2, seeds=count)
    at_least(0, first_seed=first)
    return range(first, first + count)


def closed_loops(loop: Loop, seeds: range, periods: Sequence[int]) -> dict:
    """How the loops were run, the normaliser's score, and ``closed_loop``, the rows of the table."""
    experts = dict.fromkeys((loop.plant.normaliser, next(iter(loop.plant.experts()))))
    perfect = {name: runs_of(perfect_feedback(loop, name), seeds) for name in experts}
    optimal = perfect[loop.plant.normaliser]
    best = [outcome.raw_score() for outcome in optimal]
    imitated = perfect[next(iter(loop.plant.experts()))]
    return {
        "codec": loop.radio.codec,
        "optimal_policy": loop.plant.normaliser,
        "optimal_raw_score": float(torch.cat(best).mean()),
        "optimal_score_by_slot": score_by_slot(optimal),
        "starts": f"{len(seeds)} seeds x {loop.num_devices}",
        "seeds": list(seeds),
        "starts_per_seed": loop.num_devices,
        "slots": loop.slots,
        "frame_history": loop.frame_history,
        "blend": loop.blend,
        "closed_loop": [summary("expert, perfect feedback", 1, imitated, best), *rows(loop, seeds, periods, best)],
    }


def runs_of(loop: Loop, seeds: range) -> list[Run]:
    """The loop from every set of starts."""
    return [run(loop, seed) for seed in seeds]


def rows(loop: Loop, seeds: range, periods: Sequence[int], optimal: list[Tensor]) -> Iterator[dict]:
    """The model and its baselines at every period."""
    own = LABELS.get(loop.controller.kind, loop.controller.kind)
    for period in tqdm(periods, desc="closed loops", unit="period"):
        if period == ONCE and has_watched_prediction(loop):
            yield run_watched(own, every(loop, period), seeds, optimal)
        else:
            yield summary(own, period, runs_of(every(loop, period), seeds), optimal)
        for name, baseline in baselines(loop, period).items():
            yield summary(name, period, runs_of(every(baseline, period), seeds), optimal)


def baselines(loop: Loop, period: int) -> dict[str, Loop]:
    """The expert on the true state, which is sent when the model's embedding would be; not where it always is."""
    if period == 1:
        return {}
    controllers = {"expert, hold last": HOLD, "expert, zero": ZERO}
    if period == ONCE and state_is_physics(loop.plant):
        controllers["expert, plan sent once"] = EXACT
    return {name: replace(loop, controller=kind, radio=LOSSLESS, blend=1.0) for name, kind in controllers.items()}


def has_watched_prediction(loop: Loop) -> bool:
    """Whether the plant watches a state that the model predicts and that its probe can read."""
    return loop.plant.spec.watched is not None and loop.controller.has_predictor and loop.controller.probe is not None


def run_watched(name: str, loop: Loop, seeds: range, optimal: list[Tensor]) -> dict:
    """The row of a loop that hears once, with the error of the watched state as the probe reads it from the belief."""
    spec, probe = loop.plant.spec, at_weights(loop.controller, loop.controller.probe)
    index, errors, runs = spec.state_names.index(spec.watched), [], []

    def watch(slot: int, now: TensorDictBase) -> None:
        of_seed.append((probe(now["belief"]) - now["state"])[:, index].abs())

    for seed in seeds:
        of_seed: list[Tensor] = []
        runs.append(run(loop, seed, watch))
        errors.append(torch.stack(of_seed))
    return summary(name, ONCE, runs, optimal) | watched_figures(torch.cat(errors, dim=1), spec)


def pictures(loop: Loop, result: dict, folder: Path, video: bool) -> None:
    """The plots, and the film of the first start after those of the figures."""
    loop_plot(result["closed_loop"], folder / "score.png")
    if any(row["update_every"] == "once" for row in result["closed_loop"]):
        horizon_plot(result["closed_loop"], result["optimal_score_by_slot"], folder / "horizon.png")
    if not video:
        return
    if not draws(loop.controller):
        print("There is no film, because the decoder of this model was never trained.")
    else:
        look_inside(one_start(loop), result["seeds"][-1] + 1, folder / "loop.mp4", folder / "inside.png")


def one_start(loop: Loop) -> Loop:
    """The loop of a single device; the seed after those of the figures is the start that is shown."""
    return replace(loop, num_devices=1)


def after(period: int) -> str:
    """What a recording calls the run with an update every ``period`` slots."""
    return {ONCE: "once", 1: "every slot"}.get(period, f"every {period} slots")
