"""The model card of a zoo entry: everything on it is taken from the model and its metrics.json."""

from __future__ import annotations

from torch import nn

from tsjepa.zoo.verify import own_rows

FRONT_MATTER = """---
license: apache-2.0
library_name: tsjepa
pipeline_tag: robotics
tags: [control, cart-pole, {tag}]
---
"""
# By kind: the tag on the Hub, and what the model is.
KINDS = {
    "tsjepa": (
        "jepa",
        "Context encoder, predictor and semantic actor (TS-JEPA) for the cart-pole of tsjepa, at {interval:g} ms a "
        "slot. A device sends an embedding of {dim} numbers instead of frames; between updates the controller predicts "
        "it.",
    ),
    "supervised": (
        "imitation-learning",
        "Supervised baseline for the cart-pole of tsjepa, at {interval:g} ms a slot: encoder and actor, trained "
        "together on the expert's commands. It has no predictor; between updates the last command is held.",
    ),
    "autoencoder": (
        "autoencoder",
        "Generative baseline for the cart-pole of tsjepa, at {interval:g} ms a slot: the code of {dim} numbers is "
        "decoded to frames, a small network reads the state from them, and the expert's law gives the command. It has "
        "no predictor; between updates the last command is held.",
    ),
}
USE = (
    "Simulated predictive control over a radio, comparison with other encoders, and a start for fits of one's own "
    "(`pretrained: {name}` in a recipe)."
)
LIMITS = (
    "It has seen one simulated cart-pole through one camera ({stack} frames of 64 x 128, {interval:g} ms apart): "
    "another camera, plant or slot length needs a model of its own, and nothing here was tried on hardware. The scores "
    "hold for |x| <= 0.8 m, |theta| <= 0.3 rad and velocities within 0.3 at the start, {noise}; colours and light "
    "other than the training's were not tested."
)


def kind_of(model: nn.Module) -> str:
    """A key of :data:`KINDS`."""
    from tsjepa.models import SemanticController

    if not isinstance(model, SemanticController):
        return "autoencoder"
    return "tsjepa" if model.has_predictor else "supervised"


def card(name: str, model: nn.Module, metrics: dict) -> str:
    """The card in Markdown.

    Args:
        name: of the entry.
        model: that it holds.
        metrics: what ``tsjepa evaluate`` wrote, with ``training``, ``data_sets``, ``trained_with`` and ``weights`` as
            :func:`tsjepa.zoo.export.export` adds them; parts that are absent leave no line.
    """
    architecture = model.architecture
    interval_ms = 1000 * architecture.sampling_interval
    tag, what = KINDS[kind_of(model)]
    noise = metrics.get("process_noise_std", 0)
    sections = [
        FRONT_MATTER.format(tag=tag) + f"# {name}",
        what.format(interval=interval_ms, dim=architecture.embedding_dim),
        usage(name, has_predictor=kind_of(model) == "tsjepa"),
        *figures(metrics),
        *training(metrics),
        "## Use and limits",
        USE.format(name=name),
        LIMITS.format(
            stack=architecture.frame_stack,
            interval=interval_ms * architecture.frame_spacing,
            noise=f"with noise of {noise:g} on both velocities after every slot" if noise else "without process noise",
        ),
    ]
    return "\n\n".join(sections) + "\n"


def usage(name: str, has_predictor: bool) -> str:
    """How to load and call it."""
    lines = [
        "```python",
        "import tsjepa",
        "",
        f'model = tsjepa.load("{name}")',
        "z = model.encode(frames)  # uint8 [..., kappa, H, W, 3] -> [..., d]",
        "u = model.act(z)  # newtons",
        *(["z_next = model.predict(z, u)"] if has_predictor else []),
        "```",
    ]
    return "\n".join(lines)


def figures(metrics: dict) -> list[str]:
    """The closed loops; nothing where nobody has evaluated the model."""
    from tsjepa.evaluation.evaluate import ANGLE_LIMIT, FIRST_SLOT

    rows = own_rows(metrics)
    if not rows:
        return []
    made_by, machine = metrics["made_by"], metrics.get("machine")
    on = f" on {machine['cores']} cores of {machine['processor']}" if machine else ""
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
        *(
            f"Sent once, the mean error of the probed angle passes {ANGLE_LIMIT} rad "
            f"{'in no slot' if row[FIRST_SLOT] is None else f'first in slot {row[FIRST_SLOT]}'}."
            for row in rows.values()
            if FIRST_SLOT in row
        ),
        f"Made by `{made_by['command']}` at commit {made_by['commit']}, {made_by['date']}{on}.",
    ]


def training(metrics: dict) -> list[str]:
    """Commands, data and weights."""
    lines = []
    for fit in metrics.get("training", []):
        origin = [f"seed {fit['seed']}", *([f"commit {fit['commit']}", fit["date"]] if "commit" in fit else [])]
        lines.append(f"- `{fit['command']}` ({', '.join(origin)})")
    for data in metrics.get("data_sets", []):
        episodes = ", ".join(f"{count} {split}" for split, count in data["episodes"].items())
        lines.append(
            f"- data `{data['path']}`, episodes of {data['slots']} slots of {1000 * data['sampling_interval']:g} ms: "
            f"{episodes}"
        )
    if metrics.get("trained_with"):
        lines.append(f"- {metrics['trained_with']}")
    if "weights" in metrics:
        lines.append(f"- {metrics['weights']['parameters']:,} parameters, stored as {metrics['weights']['dtype']}")
    return ["## Training", "\n".join(lines)] if lines else []
