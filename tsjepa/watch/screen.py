"""What all browsers share: the sliders, the newest state of the fleet, and its picture."""

from __future__ import annotations

import copy

import cv2
import torch

from tsjepa.evaluation.films import drawn, draws
from tsjepa.models import Controller
from tsjepa.plants.plant import Plant
from tsjepa.watch.process import Ask
from tsjepa.watch.setting import Setting, Snapshot
from tsjepa.watch.tiles import Layout, tiles

QUALITY = 85  # of the JPEG


class Screen:
    """Draws the fleet when it is asked to.

    Args:
        ask: of the running fleet.
        setting: where the sliders stand; they change it.
        plant: whose cameras are drawn.
        controller: whose beliefs are drawn too, where it is a model with a trained decoder.
    """

    def __init__(self, ask: Ask, setting: Setting, plant: Plant, controller: str | Controller) -> None:
        self.setting, self.pushed = setting, []
        self.now: Snapshot | None = None
        self.jpeg, self.pictures = b"", 0
        self._ask, self._model = ask, controller if draws(controller) else None
        self._plant = plant

    def push(self, device: int) -> None:
        """Hits a device when the fleet is asked next."""
        self.pushed.append(device)

    def push_someone(self) -> int:
        """Hits the device that scores best; returns its number."""
        device = 0 if self.now is None else int(self.now.score.argmax())
        self.push(device)
        return device

    def device_at(self, x: float, y: float) -> int | None:
        """The device at a pixel of the picture, or None."""
        if self.now is None:
            return None
        layout = Layout(len(self.now.age), self._plant.spec.frame, self._model is not None)
        return layout.device_at(x, y)

    def draw(self) -> None:
        """Asks the fleet how it is and draws it.

        Raises:
            EOFError: the fleet has ended.
        """
        pushed, self.pushed = self.pushed, []
        now = self._ask(copy.copy(self.setting), pushed)
        camera = self._plant.render(now.scenes)
        belief = None if self._model is None else drawn(self._model, torch.from_numpy(now.beliefs))
        encoded = cv2.imencode(".jpg", tiles(now, camera, belief), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
        self.now, self.jpeg, self.pictures = now, encoded.tobytes(), self.pictures + 1
