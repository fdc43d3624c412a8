"""A real camera through OpenCV, and the function that drives an actuator."""

from __future__ import annotations

import importlib
import threading
from collections import deque
from collections.abc import Callable

import cv2
import numpy as np

from tsjepa.support.trust import TRUST, may_import

Actuate = Callable[[np.ndarray], None]


class Camera:
    """The newest stack of a camera, and an actuator that takes each command when it comes.

    A camera is read in a thread, and what is used is its newest frame. A film is read a frame a slot, and starts again
    at its end.

    Args:
        source: number of a camera, or a file, or whatever else OpenCV opens.
        actuate: called with a command [m]; None for a device that only watches.
        frame: height and width of a picture.
        frame_stack, frame_spacing: of the model.

    Raises:
        FileNotFoundError: OpenCV cannot open it.
    """

    at_once = True  # an actuator does not wait for the slot's end
    place = None

    def __init__(
        self, source: str, actuate: Actuate | None, frame: tuple[int, int], frame_stack: int, frame_spacing: int
    ) -> None:
        self.source, self.actuate, self.frame, self.spacing = source, actuate, frame, frame_spacing
        self.video = cv2.VideoCapture(int(source) if source.isdigit() else source)
        if not self.video.isOpened():
            raise FileNotFoundError(f"OpenCV opens no camera and no film {source!r}.")
        self.newest = self._read()
        span = (frame_stack - 1) * frame_spacing + 1
        self.frames: deque[np.ndarray] = deque([self._picture()] * span, maxlen=span)
        self.refused = 0
        self._open = True
        self._film = self.video.get(cv2.CAP_PROP_FRAME_COUNT) > 0
        self._thread = threading.Thread(target=self._follow, daemon=True)
        if not self._film:
            self._thread.start()

    def look(self) -> np.ndarray:
        """The newest stack, uint8 [1, frame_stack, H, W, 3], oldest frame first."""
        if self._film:
            self.newest = self._read()
        self.frames.append(self._picture())
        return np.stack(list(self.frames)[:: self.spacing])[None]

    def earlier(self) -> list[np.ndarray]:
        """Stacks of a warm-up: none, a camera sees the machine for the first time when it looks."""
        return []

    def act(self, commands: np.ndarray) -> bool:
        """Gives the actuator a command [1, m]; a function that fails is counted."""
        if self.actuate is not None:
            try:
                self.actuate(commands[0])
            except Exception:
                # the loop has to go on, so that the watchdog still works
                self.refused += 1
        return False

    def summary(self) -> dict:
        """How often the actuator's function has failed."""
        return {"actuator_failures": self.refused}

    def close(self) -> None:
        """Lets the camera go."""
        self._open = False
        if self._thread.is_alive():
            self._thread.join(timeout=1.0)
        self.video.release()

    def _follow(self) -> None:
        while self._open:
            self.newest = self._read()

    def _read(self) -> np.ndarray:
        """The next frame, BGR: after a film's last its first, and of a camera that is silent the one before."""
        done, picture = self.video.read()
        if not done:
            self.video.set(cv2.CAP_PROP_POS_FRAMES, 0)
            done, picture = self.video.read()
        if done:
            return picture
        return getattr(self, "newest", np.zeros((*self.frame, 3), np.uint8))

    def _picture(self) -> np.ndarray:
        """The newest frame as the model takes it."""
        height, width = self.frame
        picture = self.newest
        if picture.shape[:2] != self.frame:
            picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(picture[..., ::-1])


def find_actuator(path: str | None) -> Actuate | None:
    """The function ``package.module.function``, or None.

    Raises:
        ValueError: there is none, or it is not this package's own and nobody has said that it is trusted.
    """
    if path is None:
        return None
    module, _, name = path.rpartition(".")
    if not may_import(path):
        raise ValueError(f"The actuator {path} is code of yours: add {TRUST} to run it.")
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"There is no function {path!r} ({error}): write package.module.function.") from error
    if not callable(found):
        raise ValueError(f"{path} is no function: write package.module.function.")
    return found
