"""``tsjepa export``: a trained model and its evaluation become an entry of the zoo."""

from __future__ import annotations

import json
from pathlib import Path

from tsjepa import zoo


def export(
    model: str, name: str, evaluation: str = "runs/evaluation/evaluation.json", folder: str = "checkpoints"
) -> None:
    """Writes ``folder/name`` with the weights of ``model``, the figures of ``evaluation`` and a model card.

    Args:
        model: folder of a trained model, such as runs/actor/model.
        name: of the entry.
        evaluation: what ``tsjepa evaluate`` wrote about this model.
        folder: of the zoo.
    """
    path = Path(evaluation)
    if not path.is_file():
        raise FileNotFoundError(f"There is no evaluation {path}: run `tsjepa evaluate --model {model}` first.")
    figures = json.loads(path.read_text())
    if Path(figures["model"]).resolve() != Path(model).resolve():
        raise ValueError(f"{path} is about {figures['model']}, not about {model}: evaluate the model that is exported.")
    entry = zoo.save(zoo.load(model), Path(folder) / name, figures, card(name, figures))
    print(f"{name} written to {entry}.")


def card(name: str, figures: dict) -> str:
    """The model card, in Markdown."""
    rows = [row for row in figures["closed_loop"] if row["controller"] == "TS-JEPA"]
    lines = [
        f"# {name}",
        "",
        "Context encoder, predictor, semantic actor and state probe for the 20 ms cart-pole of tsjepa.",
        "",
        "```python",
        "import tsjepa",
        "",
        f'model = tsjepa.load("{name}")',
        "z = model.encode(frames)  # uint8 [..., kappa, H, W, 3] -> [..., d]",
        "u = model.act(z)",
        "z_next = model.predict(z, u)  # newtons in, newtons out",
        "```",
        "",
        f"Closed loop on {figures['starts']} held-out starts; normalised by {figures['optimal_policy']} with perfect "
        "feedback.",
        "",
        "| update every | normalised score (95 %) | failures | command NMAE |",
        "|---|---|---|---|",
        *(
            f"| {row['update_every']} | {row['normalized_score']:.3f} ± {row['interval_95']:.3f} "
            f"| {row['failures']} of {row['starts']} | {row['command_nmae']:.4f} |"
            for row in rows
        ),
        "",
        f"Made by `{figures['made_by']['command']}` at commit {figures['made_by']['commit']}, "
        f"{figures['made_by']['date']}. All figures are in metrics.json.",
    ]
    return "\n".join(lines) + "\n"
