"""The film of a fleet: every device a tile with its camera's picture, who transmits, who is stale, who has failed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tsjepa.evaluation.films import write_video
from tsjepa.evaluation.metrics import Run
from tsjepa.evaluation.shown import Shown
from tsjepa.plants.plant import Plant
from tsjepa.support.files import whole

TILE_WIDTH = 96  # pixels
BORDER = 4
STALE_AGE = 20  # slots; a tile is fully shaded from here on
MOST_SHADED = 0.6  # of a picture's colour that gives way to the shade
# BGR
DELIVERED, LOST, SILENT = (178, 114, 0), (0, 94, 213), (225, 225, 225)
STALE, FAILED, INK, GOOD = (120, 190, 250), (150, 150, 150), (50, 50, 50), (115, 158, 0)
LEGEND = (("delivered", DELIVERED), ("lost", LOST), ("stale", STALE), ("failed", FAILED), ("score", GOOD))


def fleet_film(fleets: dict[str, Shown], plant: Plant, folder: Path) -> None:
    """Writes fleet.mp4 and a smaller fleet.gif into ``folder``: one grid of devices per scheduler, below each other."""
    from PIL import Image

    count = max(shown.run.age.shape[1] for shown in fleets.values())
    slots = min(len(shown.run.age) for shown in fleets.values())
    columns = grid_columns(count, *tile_size(plant.spec.frame))
    frames = [
        np.concatenate([grid(name, shown, plant, slot, columns) for name, shown in fleets.items()])
        for slot in range(slots)
    ]
    write_video(folder / "fleet.mp4", frames)
    pictures = [Image.fromarray(frame[..., ::-1]).quantize(64, dither=Image.Dither.NONE) for frame in frames[::5]]
    with whole(folder / "fleet.gif", ".gif") as partial:
        pictures[0].save(partial, save_all=True, append_images=pictures[1:], duration=200, loop=0)


def tile_size(frame: tuple[int, int]) -> tuple[int, int]:
    """Height and width in pixels of a tile whose picture has the proportions of ``frame`` (H, W)."""
    return round(TILE_WIDTH * frame[0] / frame[1]), TILE_WIDTH


def grid_columns(count: int, height: int, width: int) -> int:
    """Columns of a grid of tiles that is about twice as wide as it is high."""
    return min(count, math.ceil(math.sqrt(2 * count * height / width)))


def grid(name: str, shown: Shown, plant: Plant, slot: int, columns: int) -> np.ndarray:
    """One scheduler's fleet in one slot: what the cameras see as it begins, and who transmits it. BGR."""
    import cv2

    run = shown.run
    count, fallen = run.age.shape[1], has_fallen(run, slot)
    score = run.slot_score()[slot - 1].tolist() if slot else [0.0] * count  # of the state that the last slot ended in
    height, width = tile_size(plant.spec.frame)
    tiles = []
    for device, frame in enumerate(plant.render(shown.scenes[slot].numpy())):
        picture = cv2.resize(frame[..., ::-1], (width, height), interpolation=cv2.INTER_AREA)
        tiles.append(tile(picture, run, slot, device, bool(fallen[device]), score[device]))
    tiles += [np.full_like(tiles[0], 255)] * (-count % columns)
    rows = [np.concatenate(tiles[start : start + columns], axis=1) for start in range(0, len(tiles), columns)]
    text = f"{name}   slot {slot}   {fallen.sum()} of {count} failed   mean age {run.age[slot].double().mean():.1f}"
    picture = np.concatenate([header(text, rows[0].shape[1]), *rows])
    # video codecs want even sizes
    return np.pad(picture, ((0, picture.shape[0] % 2), (0, picture.shape[1] % 2), (0, 0)), constant_values=255)


def header(text: str, width: int) -> np.ndarray:
    """The line above a grid: what is shown, and what the colours mean as far as there is room."""
    import cv2

    picture = np.full((24, width, 3), 255, np.uint8)
    cv2.putText(picture, text, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.42, INK, 1, cv2.LINE_AA)
    x = width - 6
    for label, color in reversed(LEGEND):
        x -= 7 * len(label) + 20
        if x > 7 * len(text):
            cv2.rectangle(picture, (x, 7), (x + 10, 17), color, -1)
            cv2.putText(picture, label, (x + 14, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.38, INK, 1, cv2.LINE_AA)
    return picture


def has_fallen(run: Run, slot: int) -> np.ndarray:
    """[I] bool: which devices have failed in this slot or before."""
    return run.failed_now[: slot + 1].any(0).numpy()


def tile(picture: np.ndarray, run: Run, slot: int, device: int, fallen: bool, score: float) -> np.ndarray:
    """One device: its picture [H, W, 3], shaded by age; border by what became of its transmission; age; a score bar."""
    import cv2

    height, width = picture.shape[:2]
    age = int(run.age[slot, device])
    share = 1.0 if fallen else min(1.0, (age - 1) / (STALE_AGE - 1))
    shade = np.array(FAILED if fallen else STALE)
    picture = (picture + MOST_SHADED * share * (shade - picture)).round().astype(np.uint8)
    reach = round(score * (width - 2 * BORDER))
    picture[height - BORDER - 3 : height - BORDER, BORDER : BORDER + reach] = GOOD
    for color, thickness in ((INK, 2), ((255, 255, 255), 1)):  # legible on any picture
        cv2.putText(picture, str(age), (7, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.3, color, thickness, cv2.LINE_AA)
    border = SILENT
    if run.scheduled[slot, device]:
        border = DELIVERED if run.delivered[slot, device] else LOST
    cv2.rectangle(picture, (1, 1), (width - 2, height - 2), border, BORDER - 1)
    return picture
