"""The plot and the film of one evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from tsjepa.evaluation.closed_loop import SemanticPolicy, Starts
from tsjepa.models import SemanticController

FILM_PERIOD = 5  # slots between updates in the film
ZOOM = 4
TURNED_TO_PREDICTION = (60, 60, 200)  # BGR of the bar under a frame whose embedding was predicted
TURNED_TO_RECEIVED = (60, 160, 60)


def loop_plot(rows: list[dict], path: Path) -> None:
    """Share of starts in the box against time, one panel a controller, one line an update period."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    controllers = [name for name in dict.fromkeys(row["controller"] for row in rows) if "perfect" not in name]
    perfect = rows[0]["score_by_slot"]
    figure, axes = plt.subplots(1, len(controllers), figsize=(4.2 * len(controllers), 3.2), sharey=True, squeeze=False)
    for axis, name in zip(axes[0], controllers, strict=True):
        axis.plot(perfect, color="black", linewidth=1, linestyle=":", label="expert, perfect feedback")
        for row in rows:
            if row["controller"] == name:
                axis.plot(row["score_by_slot"], label=f"update every {row['update_every']}", linewidth=1.4)
        axis.set(title=name, xlabel="slot", ylim=(0, 1.02))
        axis.legend(fontsize=7)
    axes[0][0].set_ylabel("share of starts in the box")
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plt.close(figure)


def loop_video(model: SemanticController, renderer, starts: Starts, path: Path) -> None:
    """Film of one start with an update every 5 slots: the true frame, and below it the state the embedding holds.

    The bar below is green in slots whose embedding was received and red where it was predicted.
    """
    import cv2

    from tsjepa.evaluation.closed_loop import is_update, run

    policy = SemanticPolicy(model, renderer.render, FILM_PERIOD)
    frames = []

    def filmed(slot: int, observation) -> torch.Tensor:
        action = policy(slot, observation)
        believed = model.probe(policy.belief)[:1, :2]
        qpos = torch.cat((observation["state"][:1, :2], believed)).double().numpy()
        true, imagined = (enlarge(frame) for frame in renderer.render(qpos))
        bar = np.empty((12, true.shape[1], 3), np.uint8)
        bar[:] = TURNED_TO_RECEIVED if is_update(slot, FILM_PERIOD) else TURNED_TO_PREDICTION
        caption(true, f"slot {slot}: camera")
        caption(imagined, "state read from the embedding at the controller")
        frames.append(np.concatenate((true, imagined, bar)))
        return action

    run(starts, filmed)
    write_video(path, frames, cv2.VideoWriter_fourcc(*"mp4v"))


def enlarge(frame: np.ndarray) -> np.ndarray:
    """RGB frame to a larger BGR one."""
    return np.ascontiguousarray(frame[..., ::-1].repeat(ZOOM, 0).repeat(ZOOM, 1))


def caption(frame: np.ndarray, text: str) -> None:
    """Writes ``text`` into the upper left corner of a BGR frame."""
    import cv2

    cv2.putText(frame, text, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)


def write_video(path: Path, frames: list[np.ndarray], codec: int, frames_per_second: int = 25) -> None:
    """Writes BGR frames of one size."""
    import cv2

    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), codec, frames_per_second, (width, height))
    for frame in frames:
        writer.write(frame)
    writer.release()
