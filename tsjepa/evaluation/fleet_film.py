"""The film of a fleet: every device a tile, who transmits, who is stale, who has fallen."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tsjepa.evaluation.fleet import FleetRun
from tsjepa.evaluation.pictures import write_video
from tsjepa.plants.score import FAILURE_POSITION, has_failed, in_box

TILE_HEIGHT, TILE_WIDTH = 66, 96
BORDER = 4
PIXELS_PER_METRE = (TILE_WIDTH - 2 * BORDER - 10) / (2 * FAILURE_POSITION)
RAIL_Y = TILE_HEIGHT - 16
POLE_PIXELS = 34
STALE_AGE = 20  # slots; a tile is fully shaded from here on
# BGR
DELIVERED, LOST, SILENT = (178, 114, 0), (0, 94, 213), (225, 225, 225)
STALE, FALLEN, INK, IN_BOX = (120, 190, 250), (150, 150, 150), (50, 50, 50), (115, 158, 0)
LEGEND = (("delivered", DELIVERED), ("lost", LOST), ("stale", STALE), ("fallen", FALLEN), ("in the box", IN_BOX))


def fleet_film(runs: dict[str, FleetRun], folder: Path) -> None:
    """Writes fleet.mp4 and a smaller fleet.gif into ``folder``: one grid of devices per scheduler, below each other."""
    import cv2
    from PIL import Image

    columns = grid_columns(max(run.age.shape[1] for run in runs.values()))
    slots = min(len(run.age) for run in runs.values())
    frames = [np.concatenate([grid(name, run, slot, columns) for name, run in runs.items()]) for slot in range(slots)]
    write_video(folder / "fleet.mp4", frames, cv2.VideoWriter_fourcc(*"mp4v"))
    pictures = [Image.fromarray(frame[..., ::-1]).quantize(16, dither=Image.Dither.NONE) for frame in frames[::5]]
    pictures[0].save(folder / "fleet.gif", save_all=True, append_images=pictures[1:], duration=200, loop=0)


def grid_columns(count: int) -> int:
    """Columns of a grid of tiles that is about twice as wide as it is high."""
    return min(count, math.ceil(math.sqrt(2 * count * TILE_HEIGHT / TILE_WIDTH)))


def grid(name: str, run: FleetRun, slot: int, columns: int) -> np.ndarray:
    """One scheduler's fleet in one slot: the state that the plant was in, and who transmitted it. BGR."""
    import cv2

    count = run.age.shape[1]
    fallen = has_fallen(run, slot)
    tiles = [tile(run, slot, device, bool(fallen[device])) for device in range(count)]
    tiles += [np.full_like(tiles[0], 255)] * (-count % columns)
    rows = [np.concatenate(tiles[start : start + columns], axis=1) for start in range(0, len(tiles), columns)]
    header = np.full((24, rows[0].shape[1], 3), 255, np.uint8)
    text = f"{name}   slot {slot}   {fallen.sum()} of {count} fallen   mean age {run.age[slot].double().mean():.1f}"
    cv2.putText(header, text, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.42, INK, 1, cv2.LINE_AA)
    x = header.shape[1] - 6
    for label, color in reversed(LEGEND):
        x -= 7 * len(label) + 20
        if x > 7 * len(text):
            cv2.rectangle(header, (x, 7), (x + 10, 17), color, -1)
            cv2.putText(header, label, (x + 14, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.38, INK, 1, cv2.LINE_AA)
    picture = np.concatenate([header, *rows])
    # video codecs want even sizes
    return np.pad(picture, ((0, picture.shape[0] % 2), (0, picture.shape[1] % 2), (0, 0)), constant_values=255)


def has_fallen(run: FleetRun, slot: int) -> np.ndarray:
    """[I] bool: which devices have failed in this slot or before."""
    return has_failed(run.loop.state[: slot + 1]).any(0).numpy()


def tile(run: FleetRun, slot: int, device: int, fallen: bool) -> np.ndarray:
    """One device: cart and pole, shade by age, border by what became of its transmission, the age as a number."""
    import cv2

    x, theta = run.loop.state[slot, device, :2].tolist()
    age = int(run.age[slot, device])
    staleness = min(1.0, (age - 1) / (STALE_AGE - 1))
    shade = FALLEN if fallen else tuple(round(255 + staleness * (value - 255)) for value in STALE)
    picture = np.full((TILE_HEIGHT, TILE_WIDTH, 3), shade, np.uint8)
    inside = bool(in_box(run.loop.state[slot, device]))
    centre = round(TILE_WIDTH / 2 + max(-2.0, min(2.0, x)) * PIXELS_PER_METRE)
    top = (round(centre + POLE_PIXELS * math.sin(theta)), round(RAIL_Y - POLE_PIXELS * math.cos(theta)))
    cv2.line(picture, (BORDER, RAIL_Y), (TILE_WIDTH - BORDER, RAIL_Y), (170, 170, 170), 1)
    cv2.rectangle(picture, (centre - 8, RAIL_Y - 4), (centre + 8, RAIL_Y + 4), IN_BOX if inside else INK, -1)
    cv2.line(picture, (centre, RAIL_Y), top, IN_BOX if inside else INK, 3, cv2.LINE_AA)
    cv2.putText(picture, str(age), (8, TILE_HEIGHT - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.3, INK, 1, cv2.LINE_AA)
    border = SILENT
    if run.scheduled[slot, device]:
        border = DELIVERED if run.delivered[slot, device] else LOST
    cv2.rectangle(picture, (1, 1), (TILE_WIDTH - 2, TILE_HEIGHT - 2), border, BORDER - 1)
    return picture
