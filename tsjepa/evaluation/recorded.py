"""Runs as one file for the Rerun viewer: pictures, beliefs, states, commands, ages and who sends."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tsjepa.evaluation.films import drawn, draws
from tsjepa.evaluation.shown import Shown
from tsjepa.models import Controller
from tsjepa.plants.plant import Plant
from tsjepa.support.recording import arrange, introduce, record_slot, recording

if TYPE_CHECKING:
    import rerun


def record_runs(path: str | Path, runs: dict[str, Shown], plant: Plant, controller: str | Controller) -> None:
    """Writes ``path``, with one tab for each of ``runs``; its entities lie below "NAME OF THE RUN/device NUMBER".

    Args:
        path: of the ``.rrd`` file.
        runs: by name, all of the same plant and controller.
        plant: whose cameras are drawn.
        controller: the beliefs of a model with a trained decoder are drawn too.

    Raises:
        ValueError, ModuleNotFoundError: as :func:`tsjepa.support.recording.check_recording`.
    """
    model = controller if draws(controller) else None
    devices = {
        name: [f"{name}/device {index}" for index in range(seen.run.age.shape[1])] for name, seen in runs.items()
    }
    with recording(path) as stream:
        arrange(stream, devices, believes=model is not None)
        for name, seen in runs.items():
            _record_run(stream, devices[name], seen, plant, model)


def _record_run(
    stream: rerun.RecordingStream, devices: list[str], seen: Shown, plant: Plant, model: Controller | None
) -> None:
    for device in devices:
        introduce(stream, device, plant.spec)
    run = seen.run
    heard = run.delivered.cummax(0).values  # before that there is no belief to draw
    radio, score = np.stack((run.scheduled, run.delivered), -1), run.slot_score()
    for slot in range(len(run.age)):
        camera = plant.render(seen.scenes[slot].numpy())
        belief = None if model is None else drawn(model, seen.beliefs[slot])
        for index, device in enumerate(devices):
            pictures = {"camera": camera[index]}
            if belief is not None and heard[slot, index]:
                pictures["belief"] = belief[index]
            numbers = {
                "state": run.state[slot, index],
                "command": run.action[slot, index],
                "age": run.age[slot, index],
                "radio": radio[slot, index],
                "score": score[slot, index],
            }
            record_slot(stream, device, slot * plant.spec.slot, pictures, numbers)
