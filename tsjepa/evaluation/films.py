"""The film and the still picture that look inside a model: what it sees, believes and expects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from tsjepa.data.storage import write_picture
from tsjepa.envs.make import at_weights
from tsjepa.evaluation.rollouts import Loop, every
from tsjepa.evaluation.shown import shown_run
from tsjepa.models import Controller
from tsjepa.support.files import whole

PERIOD = 5  # slots between updates in the film
AHEAD = 1.0  # seconds that the shown prediction looks ahead
STRIP_ROWS = 5
PANEL_WIDTH = 384  # pixels that a frame is enlarged to, about
PREDICTED, RECEIVED = (60, 60, 200), (60, 160, 60)  # BGR of the bar under a frame


def look_inside(loop: Loop, seed: int, film: Path, strip: Path) -> None:
    """Films the loop of one device with an update every 5 slots, and writes some of its pictures below each other.

    From left to right: the camera, the belief as the decoder draws it, and, of a model that predicts, the belief 1 s
    ahead as its own predictor and actor imagine it, beside what the camera sees then. The bar below is green in slots
    whose embedding was received and red in those between.

    Args:
        loop: of one device, whose model has a trained decoder; it is run on for the last pictures' second.
        seed: of the start.
        film: path of the ``.mp4`` file.
        strip: path of the ``.png`` file.

    Raises:
        OSError: the film or the picture could not be written.
    """
    model, slots = loop.controller, loop.slots
    ahead = round(AHEAD / loop.plant.spec.slot) if model.has_predictor else 0
    seen = shown_run(every(replace(loop, slots=slots + ahead), PERIOD), seed)
    camera = loop.plant.render(seen.scenes[:, 0].numpy())
    belief = seen.beliefs[:slots, 0]
    columns = [("camera", camera), ("decoded from the embedding", drawn(model, belief))]
    if ahead:
        reference = None if seen.references is None else seen.references[:slots, 0]
        later = drawn(model, imagine(model, belief, ahead, reference))
        columns += [(f"predicted {AHEAD:g} s ahead, decoded", later), (f"camera {AHEAD:g} s later", camera[ahead:])]
    pictures = [picture(columns, slot) for slot in range(slots)]
    write_video(film, pictures)
    shown = np.linspace(0, slots - 1, min(STRIP_ROWS, slots)).astype(int)
    write_picture(strip, np.concatenate([pictures[slot] for slot in shown])[..., ::-1])


@torch.no_grad()
def imagine(model: nn.Module, belief: Tensor, slots: int, reference: Tensor | None = None) -> Tensor:
    """Embeddings [..., d] that predictor and actor reach by themselves ``slots`` after ``belief`` [..., d].

    The set-points [..., r] stay as they are.
    """
    predict, act = at_weights(model, model.predict), at_weights(model, model.act)
    for _ in range(slots):
        belief = predict(belief, act(belief, reference))
    return belief


def draws(controller: str | Controller) -> bool:
    """Whether what a controller believes can be drawn: it is a model with a trained decoder."""
    decoder = controller.decoder if isinstance(controller, Controller) else None
    return decoder is not None and bool(getattr(decoder, "fitted", True))


@torch.no_grad()
def drawn(model: nn.Module, embedding: Tensor) -> np.ndarray:
    """Frames uint8 [N, H, W, 3] of embeddings [N, d]."""
    decode = at_weights(model, model.decode)
    return torch.cat([decode(part) for part in embedding.split(100)]).round().to(torch.uint8).numpy()


def picture(columns: list[tuple[str, np.ndarray]], slot: int) -> np.ndarray:
    """One slot's frames side by side with what they are, BGR, over the bar that says whether it had an update."""
    panels = []
    for index, (text, frames) in enumerate(columns):
        panels.append(enlarge(frames[slot]))
        caption(panels[-1], f"slot {slot}: {text}" if index == 0 else text)
    row = np.concatenate(panels, axis=1)
    bar = np.empty((12, row.shape[1], 3), np.uint8)
    bar[:] = PREDICTED if slot % PERIOD else RECEIVED
    return np.concatenate((row, bar))


def enlarge(frame: np.ndarray) -> np.ndarray:
    """RGB frame to a BGR one, a whole number of times as large."""
    zoom = max(1, round(PANEL_WIDTH / frame.shape[1]))
    return np.ascontiguousarray(frame[..., ::-1].repeat(zoom, 0).repeat(zoom, 1))


def caption(frame: np.ndarray, text: str) -> None:
    """Writes ``text`` into the upper left corner of a BGR frame."""
    import cv2

    cv2.putText(frame, text, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)


def write_video(path: Path, frames: list[np.ndarray], frames_per_second: int = 25) -> None:
    """Writes BGR frames uint8 [H, W, 3] of one size as an MP4 file.

    Raises:
        OSError: no room, no right to write, or no such folder; what was there stays.
    """
    import cv2

    height, width = frames[0].shape[:2]
    with whole(path, path.suffix) as partial:
        writer = cv2.VideoWriter(str(partial), cv2.VideoWriter_fourcc(*"mp4v"), frames_per_second, (width, height))
        for frame in frames:
            writer.write(frame)
        writer.release()
        # nothing above says that it failed; the number of frames is what is written last
        if count_frames(partial) != len(frames):
            raise OSError(f"The film {path} could not be written: make room, or choose a folder that can be written.")


def count_frames(path: Path) -> int:
    """Frames that a film says it has; 0 where it cannot be read."""
    import cv2

    film = cv2.VideoCapture(str(path))
    count = int(film.get(cv2.CAP_PROP_FRAME_COUNT))
    film.release()
    return count
