"""The picture of a fleet: a tile for each device, with what its camera sees beside what the controller believes."""

from __future__ import annotations

import cv2
import numpy as np

from tsjepa.evaluation.fleet_film import DELIVERED, FAILED, GOOD, INK, LOST, SILENT, grid_columns
from tsjepa.watch.setting import Snapshot

WIDTH = 160  # pixels of a picture
CAPTION, BORDER, GAP = 20, 4, 6  # pixels
PAPER = (255, 255, 255)
UNKNOWN = (235, 235, 235)  # of the belief before anything was heard


class Layout:
    """Where the tiles are.

    Args:
        count: devices.
        frame: height and width of the camera's frames.
        believes: whether there is a second picture beside the camera's.
    """

    def __init__(self, count: int, frame: tuple[int, int], believes: bool) -> None:
        self.picture = (round(WIDTH * frame[0] / frame[1]), WIDTH)
        self.height = self.picture[0] + CAPTION + 2 * BORDER + GAP
        self.width = (2 if believes else 1) * WIDTH + 2 * BORDER + GAP
        self.count, self.columns = count, grid_columns(count, self.height, self.width)

    def corner(self, device: int) -> tuple[int, int]:
        """Row and column of the pixel at a tile's upper left."""
        row, column = divmod(device, self.columns)
        return row * self.height, column * self.width

    def device_at(self, x: float, y: float) -> int | None:
        """The device whose tile lies at column ``x`` and row ``y`` of the picture, None beside all tiles."""
        row, column = int(y // self.height), int(x // self.width)
        device = row * self.columns + column
        inside = 0 <= column < self.columns and row >= 0 and device < self.count
        return device if inside else None

    def size(self) -> tuple[int, int]:
        """Height and width of the whole picture."""
        return -(-self.count // self.columns) * self.height, self.columns * self.width


def tiles(now: Snapshot, camera: np.ndarray, belief: np.ndarray | None) -> np.ndarray:
    """The fleet as one BGR picture, arranged as :class:`Layout` says.

    Args:
        now: the fleet.
        camera: RGB frames uint8 [I, H, W, 3].
        belief: the same of what the controller believes, or None.
    """
    count = len(camera)
    layout = Layout(count, camera.shape[1:3], belief is not None)
    picture = np.full((*layout.size(), 3), 255, np.uint8)
    for device in range(count):
        top, left = layout.corner(device)
        tile = picture[top : top + layout.height - GAP, left : left + layout.width - GAP]
        _frame(tile, now, device)
        _place(tile, layout, 0, camera[device])
        if belief is not None:
            _place(tile, layout, 1, belief[device] if now.heard[device] else None)
    return picture


def _frame(tile: np.ndarray, now: Snapshot, device: int) -> None:
    """Caption, score and, as the border, what became of what the device sent."""
    height, width = tile.shape[:2]
    color = FAILED if now.failed[device] else PAPER
    tile[:CAPTION] = color
    border = SILENT
    if now.sent[device]:
        border = DELIVERED if now.delivered[device] else LOST
    cv2.rectangle(tile, (1, CAPTION + 1), (width - 2, height - 2), border, BORDER - 1)
    text = f"{device}  age {now.age[device]}" + ("  failed" if now.failed[device] else "")
    cv2.putText(tile, text, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, INK, 1, cv2.LINE_AA)
    full = width // 3
    reach = round(float(now.score[device]) * full)
    tile[6:14, width - full - 4 : width - 4] = SILENT
    tile[6:14, width - full - 4 : width - full - 4 + reach] = GOOD


def _place(tile: np.ndarray, layout: Layout, index: int, frame: np.ndarray | None) -> None:
    height, width = layout.picture
    left, top = BORDER + index * width, CAPTION + BORDER
    place = tile[top : top + height, left : left + width]
    if frame is None:
        place[:] = UNKNOWN
    else:
        place[:] = cv2.resize(frame[..., ::-1], (width, height), interpolation=cv2.INTER_LINEAR)
