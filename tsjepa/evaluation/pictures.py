"""The plots of one evaluation, and the film and the still picture that look inside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.evaluation.closed_loop import SemanticPolicy, Starts, is_update, run

FILM_PERIOD = 5  # slots between updates in the film
AHEAD = 1.0  # seconds that the shown prediction looks ahead
STRIP_ROWS = 5
ZOOM = 3
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


def horizon_plot(rows: list[dict], optimal_by_slot: list[float], path: Path) -> None:
    """Normalised score of the first h slots against h, of every controller that heard from the device once, at slot 0.

    Args:
        rows: of the evaluation.
        optimal_by_slot: share of starts that the optimal policy with perfect feedback has in the box after each slot.
        path: of the picture.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    best = np.cumsum(optimal_by_slot)
    horizon = np.arange(1, len(best) + 1)
    scored = best > 0  # before that there is nothing to divide by
    figure, axis = plt.subplots(figsize=(5.6, 3.6))
    axis.axhline(1, color="black", linewidth=1, linestyle=":", label="optimal policy, perfect feedback")
    for row in rows:
        if row["update_every"] == "once":
            score = np.cumsum(row["score_by_slot"])[scored] / best[scored]
            axis.plot(horizon[scored], score, label=row["controller"], linewidth=1.6)
    axis.set(xlabel="slots since the only update", ylabel="normalised score until then", ylim=(0, None))
    axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plt.close(figure)


def look_inside(model: nn.Module, renderer, starts: Starts, film: Path, strip: Path) -> None:
    """Films one start with an update every 5 slots, and writes some of the film's pictures below each other.

    From left to right: the camera, the belief as the decoder draws it, and, of a model that predicts, the belief 1 s
    ahead as its own predictor and actor imagine it, beside what the camera sees then. The bar below is green in slots
    whose embedding was received and red in those between.

    Args:
        model: a controller whose decoder is trained.
        renderer: as :class:`tsjepa.envs.Renderer`.
        starts: of which the first is shown; the loop is run on for the last pictures' second.
        film: path of the ``.mp4`` file.
        strip: path of the ``.png`` file.
    """
    import cv2

    predicts = model.has_predictor
    ahead = round(AHEAD / starts.sampling_interval) if predicts else 0
    policy = SemanticPolicy(model, renderer.render, FILM_PERIOD)
    beliefs, states = [], []

    def watched(slot: int, observation) -> Tensor:
        action = policy(slot, observation)
        beliefs.append(policy.belief[0])
        states.append(observation["state"][0, :2])
        return action

    run(replace(starts, slots=starts.slots + ahead), watched)
    camera = renderer.render(torch.stack(states).double().numpy())
    belief = torch.stack(beliefs[: starts.slots])
    columns = [("camera", camera), ("decoded from the embedding", drawn(model, belief))]
    if predicts:
        later = drawn(model, imagine(model, belief, ahead))
        columns += [(f"predicted {AHEAD:g} s ahead, decoded", later), (f"camera {AHEAD:g} s later", camera[ahead:])]
    pictures = [picture(columns, slot) for slot in range(starts.slots)]
    write_video(film, pictures, cv2.VideoWriter_fourcc(*"mp4v"))
    shown = np.linspace(0, starts.slots - 1, min(STRIP_ROWS, starts.slots)).astype(int)
    cv2.imwrite(str(strip), np.concatenate([pictures[slot] for slot in shown]))


@torch.no_grad()
def imagine(model: nn.Module, belief: Tensor, slots: int) -> Tensor:
    """Embeddings [..., d] that predictor and actor reach by themselves ``slots`` after ``belief`` [..., d]."""
    for _ in range(slots):
        belief = model.predict(belief, model.act(belief))
    return belief


@torch.no_grad()
def drawn(model: nn.Module, embedding: Tensor) -> np.ndarray:
    """Frames uint8 [N, H, W, 3] of embeddings [N, d]."""
    return torch.cat([model.decode(part) for part in embedding.split(100)]).round().to(torch.uint8).numpy()


def picture(columns: list[tuple[str, np.ndarray]], slot: int) -> np.ndarray:
    """One slot's frames side by side with what they are, BGR, over the bar that says whether it had an update."""
    panels = []
    for index, (text, frames) in enumerate(columns):
        panels.append(enlarge(frames[slot]))
        caption(panels[-1], f"slot {slot}: {text}" if index == 0 else text)
    row = np.concatenate(panels, axis=1)
    bar = np.empty((12, row.shape[1], 3), np.uint8)
    bar[:] = TURNED_TO_RECEIVED if is_update(slot, FILM_PERIOD) else TURNED_TO_PREDICTION
    return np.concatenate((row, bar))


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
