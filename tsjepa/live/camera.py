"""A real camera through OpenCV, and the function that drives an actuator."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from tsjepa.live.notices import tell
from tsjepa.support.description import load_named

Actuate = Callable[[np.ndarray], None]
AGAIN_S = 0.01  # between two tries at a camera that gives no picture


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
        FileNotFoundError: OpenCV cannot open it, or gets no picture from it.
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
        first = self._read()
        if first is None:
            self.video.release()
            raise FileNotFoundError(
                f"OpenCV opens {source!r} and gets no picture: end other programs that use the camera, or give "
                "--camera another number or a film that is whole."
            )
        self.newest = first
        span = (frame_stack - 1) * frame_spacing + 1
        self.frames: deque[np.ndarray] = deque([self._picture()] * span, maxlen=span)
        self.refused = self.blind = 0
        self._open = True
        self._film = self.video.get(cv2.CAP_PROP_FRAME_COUNT) > 0
        self._thread = threading.Thread(target=self._follow, daemon=True)
        if not self._film:
            self._thread.start()

    def look(self) -> np.ndarray:
        """The newest stack, uint8 [1, frame_stack, H, W, 3], oldest frame first."""
        if self._film:
            self._renew()
        self.frames.append(self._picture())
        return np.stack(list(self.frames)[:: self.spacing])[None]

    def earlier(self) -> list[np.ndarray]:
        """Stacks of a warm-up: none, a camera sees the machine for the first time when it looks."""
        return []

    def act(self, commands: np.ndarray) -> bool:
        """Gives the actuator a command [1, m]; a function that fails is counted, and told of the first time."""
        if self.actuate is not None:
            try:
                self.actuate(commands[0])
            except Exception as error:
                # the loop has to go on, so that the watchdog still works
                if not self.refused:
                    tell("device", _failure(self.actuate, error))
                self.refused += 1
        return False

    def summary(self) -> dict:
        """How often the actuator's function has failed, and how often the camera gave no picture."""
        return {"actuator_failures": self.refused, "camera_failures": self.blind}

    def close(self) -> None:
        """Lets the camera go."""
        self._open = False
        if self._thread.is_alive():
            self._thread.join(timeout=1.0)
        self.video.release()

    def _follow(self) -> None:
        while self._open:
            if not self._renew():
                time.sleep(AGAIN_S)

    def _renew(self) -> bool:
        """Takes the next frame; of a camera that is silent the one before stays."""
        picture = self._read()
        if picture is not None:
            self.newest = picture
            return True
        if not self.blind:
            tell("device", f"the camera {self.source!r} gives no picture; until it does, its last one is sent again.")
        self.blind += 1
        return False

    def _read(self) -> np.ndarray | None:
        """The next frame, BGR, after a film's last its first; None where there is none."""
        done, picture = self.video.read()
        if not done:
            self.video.set(cv2.CAP_PROP_POS_FRAMES, 0)
            done, picture = self.video.read()
        return picture if done else None

    def _picture(self) -> np.ndarray:
        """The newest frame as the model takes it."""
        height, width = self.frame
        picture = self.newest
        if picture.shape[:2] != self.frame:
            picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(picture[..., ::-1])


def _failure(function: Actuate, error: Exception) -> str:
    """What a function of the user's has raised and where."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    return (
        f"the actuator {getattr(function, '__qualname__', function)} raised {type(error).__name__}: {error} "
        f"({Path(place.filename).name}, line {place.lineno}); it is called again, and more failures are only counted."
    )


def find_actuator(path: str | None) -> Actuate | None:
    """The function ``package.module.function``, or None.

    Raises:
        ValueError: there is none, or it is not this package's own and nobody has said that it is trusted.
    """
    if path is None:
        return None
    found = load_named("actuator", path)
    if not callable(found):
        raise ValueError(f"{path} is no function: write package.module.function.")
    return found
