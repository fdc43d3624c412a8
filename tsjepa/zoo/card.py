"""The model card of a zoo entry: everything on it is taken from the model and its metrics.json."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tsjepa.evaluation.summary import FIRST_LOST
from tsjepa.models import Controller
from tsjepa.support.spec import PlantSpec
from tsjepa.zoo.figures import lost_from, own_rows, seed_score

FRONT_MATTER = """---
license: apache-2.0
library_name: tsjepa
pipeline_tag: robotics
tags: [control, {machine}, {tag}]
---
"""
# By kind: the tag on the Hub, and what the model is.
KINDS = {
    "tsjepa": (
        "jepa",
        "Context encoder, predictor and semantic actor (TS-JEPA) for {machine}, at {interval:g} ms a slot. A device "
        "sends an embedding of {dim} numbers instead of frames; between updates the controller predicts it.",
    ),
    "supervised": (
        "imitation-learning",
        "Supervised baseline for {machine}, at {interval:g} ms a slot: encoder and actor, trained together on the "
        "expert's commands. It has no predictor; between updates the last command is held.",
    ),
    "autoencoder": (
        "autoencoder",
        "Generative baseline for {machine}, at {interval:g} ms a slot: the code of {dim} numbers is decoded to frames, "
        "a small network reads the state from them, and the expert's law gives the command. It has no predictor; "
        "between updates the last command is held.",
    ),
}
OBSERVES = (
    " The device remembers: what it sends is the predictor's step from its last belief, corrected by what it sees."
)
KNOWS_ITS_COMMAND = (
    " The device knows its last command: what it sends is what it sees, corrected by what that did since the older "
    "frame."
)
USE = (
    "Predictive control over a radio, comparison with other encoders, and a start for fits of one's own (`pretrained: "
    "{name}` in a recipe)."
)
LIMITS = (
    "It has seen one {seen} through one camera ({stack} frames of {height} x {width}, {interval:g} ms apart): "
    "another camera, machine or slot length needs a model of its own, and nothing here was tried on hardware.{plant} "
    "What other colours, light and cameras cost some of the entries is in docs/results/robustness.md."
)


def card(name: str, model: Controller, metrics: dict) -> str:
    """The card in Markdown.

    Args:
        name: of the entry.
        model: that it holds.
        metrics: what ``tsjepa evaluate`` wrote, with ``training``, ``data_sets``, ``trained_with`` and ``weights`` as
            :func:`tsjepa.zoo.export.export` adds them; parts that are absent leave no line.
    """
    spec, machine = model.spec, machine_name(model)
    tag, what = KINDS[model.kind]
    height, width = spec.frame
    plant = metrics.get("plant")
    sections = [
        FRONT_MATTER.format(tag=tag, machine=machine) + f"# {name}",
        what.format(machine=f"the {machine}", interval=1000 * spec.slot, dim=model.embedding_dim)
        + on_the_device(model),
        usage(name, model),
        *figures(metrics),
        *open_loop(metrics),
        *training_seeds(metrics),
        *training(metrics, spec),
        "## Use and limits",
        USE.format(name=name),
        LIMITS.format(
            seen=f"simulated {machine}" if model.plant else "recorded machine",
            stack=model.frame_stack,
            height=height,
            width=width,
            interval=1000 * spec.slot * model.frame_spacing,
            plant=f" The scores hold for {settings(plant)}." if plant and own_rows(metrics) else "",
        ),
    ]
    return "\n\n".join(sections) + "\n"


def on_the_device(model: Controller) -> str:
    """What the device does beside encoding, if anything."""
    if not model.has_observer:
        return ""
    return OBSERVES if getattr(model.observer, "memory", True) else KNOWS_ITS_COMMAND


def machine_name(model: Controller) -> str:
    """What the plant's class is called, in words joined by hyphens; "recording" where there is no plant."""
    if model.plant is None:
        return "recording"
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", model.plant["class_path"].rpartition(".")[2]).lower()


def settings(plant: dict) -> str:
    """The plant's class path, with its arguments."""
    arguments = ", ".join(f"{name}={value}" for name, value in (plant.get("init_args") or {}).items())
    return f"`{plant['class_path']}({arguments})`"


def usage(name: str, model: Controller) -> str:
    """How to load and call it."""
    spec, set_points = model.spec, getattr(getattr(model, "actor", None), "reference_low", ())
    reference = numbers("reference", "r", spec.reference_names, spec.reference_units)
    lines = [
        "```python",
        "import tsjepa",
        "",
        f'model = tsjepa.load("{name}")',
        "z = model.encode(frames)  # uint8 [..., kappa, H, W, 3] -> [..., d]",
        f"u = model.act(z{', reference' if set_points else ''})  "
        f"# {numbers('', 'm', spec.action_names, spec.action_units)}{f'; {reference}' if set_points else ''}",
        *(["z_next = model.predict(z, u)"] if model.has_predictor else []),
        *(["z = model.correct(z, u, model.encode(next_frames))"] if model.has_observer else []),
        "```",
    ]
    return "\n".join(lines)


def numbers(name: str, count: str, names: Sequence[str], units: Sequence[str]) -> str:
    """Shape of a tensor, and what its numbers are."""
    meanings = ", ".join(f"{each} ({unit})" for each, unit in zip(names, units, strict=False))
    return f"{name} [..., {count}]{': ' if meanings else ''}{meanings}".strip()


def figures(metrics: dict) -> list[str]:
    """The closed loops; nothing where nobody has evaluated the model."""
    rows = own_rows(metrics)
    if not rows:
        return []
    made_by, machine = metrics["made_by"], metrics.get("machine")
    on = f" on {machine['cores']} cores of {machine['processor']}" if machine else ""
    drawn = (metrics.get("camera") or {}).get("gl_renderer")
    lines = [
        "| update every | normalised score (95 %) | failures | command NMAE | bits per slot |",
        "|---|---|---|---|---|",
        *(
            f"| {period} | {row['normalized_score']:.3f} ± {row['interval_95']:.3f} "
            f"| {row['failures']} of {row['starts']} | {row['command_nmae']:.4f} | {row['bits_per_step']:.0f} |"
            for period, row in rows.items()
        ),
    ]
    return [
        "## Figures",
        f"Closed loop on {metrics['starts']} held-out starts; normalised by {metrics['optimal_policy']} with perfect "
        "feedback. All figures are in metrics.json.",
        "\n".join(lines),
        *(watched(row) for row in rows.values() if FIRST_LOST in row),
        f"Made by `{made_by['command']}` at commit {made_by['commit']}, {made_by['date']}{on}"
        f"{f', pictures drawn by {drawn}' if drawn else ''}.",
    ]


def open_loop(metrics: dict) -> list[str]:
    """What was measured on recorded trajectories; nothing where there were none."""
    figures = metrics.get("open_loop")
    if not figures:
        return []
    wanted = "the recorded commands" if figures.get("command_nmae_to") == "action" else "the expert's"
    sentence = f"On recorded test trajectories the command NMAE, to {wanted}, is {figures['command_nmae']:.4f}"
    skill = {horizon: value for horizon, value in figures.get("skill_over_copying", {}).items() if value is not None}
    if skill:
        values = ", ".join(f"{value:.3f}" for value in skill.values())
        sentence += f"; the prediction skill over copying after {', '.join(skill)} slots is {values}"
    return [f"{sentence}."]


def watched(row: dict) -> str:
    """When the error of the state that the plant watches passes its limit."""
    slot = row[FIRST_LOST]
    return "Sent once, the mean error of the probed {state} passes {limit:g} {unit} {when}.".format(
        **row["watched"], when="in no slot" if slot is None else f"first in slot {slot}"
    )


def training_seeds(metrics: dict) -> list[str]:
    """The closed loops of all training seeds; nothing where there was one."""
    of_seeds = metrics.get("training_seeds")
    if of_seeds is None:
        return []
    validation, nmae = of_seeds["validation"], of_seeds["command_nmae"]
    lines = [
        "| update every | score ± over training seeds ± over starts | failures | command NMAE |",
        "|---|---|---|---|",
        *(
            f"| {row['update_every']} | {seed_score(row)} | {row['failures']} of {row['starts']} "
            f"| {row['command_nmae']:.4f} |"
            for row in of_seeds["closed_loop"]
        ),
    ]
    said = [
        f"On recorded test trajectories the command NMAE is {nmae['mean']:.4f} ± {nmae['interval_95']:.4f} over "
        "training seeds."
    ]
    if FIRST_LOST in of_seeds:
        watched = "Sent once, the mean error of the probed {state} passes {limit:g} {unit} from slot"
        said.append(f"{watched.format(**of_seeds[FIRST_LOST]['watched'])} {lost_from(of_seeds)} on.")
    return [
        "## Over training seeds",
        f"The same recipe with the seeds {', '.join(map(str, of_seeds['seeds']))}, on {of_seeds['starts']} starts that "
        f"no recipe was chosen on (from {of_seeds['start_seeds'][0]} on). The weights here are those of seed "
        f"{of_seeds['shipped']}, whose command NMAE on the split {validation['split']} is the smallest: "
        f"{', '.join(f'{error:.4f}' for error in validation['command_nmae'])}. The first interval is that of 95 % over "
        "training seeds, the second that over the sets of starts, of the mean over training seeds.",
        "\n".join(lines),
        " ".join(said),
    ]


def training(metrics: dict, spec: PlantSpec) -> list[str]:
    """Commands, data and weights."""
    lines = []
    for fit in metrics.get("training", []):
        origin = [f"seed {fit['seed']}", *([f"commit {fit['commit']}", fit["date"]] if "commit" in fit else [])]
        lines.append(f"- `{fit['command']}` ({', '.join(origin)})")
    for data in metrics.get("data_sets", []):
        episodes = ", ".join(f"{count} {split}" for split, count in data["episodes"].items())
        length = f"episodes of {data['slots']} slots" if "slots" in data else "episodes of slots"
        lines.append(f"- data `{data['path']}`, {length} of {1000 * spec.slot:g} ms: {episodes}")
    if metrics.get("trained_with"):
        lines.append(f"- {metrics['trained_with']}")
    if "weights" in metrics:
        lines.append(f"- {metrics['weights']['parameters']:,} parameters, stored as {metrics['weights']['dtype']}")
    return ["## Training", "\n".join(lines)] if lines else []
