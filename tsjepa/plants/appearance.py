"""How an episode looks beyond the machine's own motion: colours, light, camera, what stands behind it and before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tsjepa.plants.streams import DISTRACTOR, LIGHT, OCCLUDER, SHIFT, uniforms
from tsjepa.support.checks import at_least, within

DARKEST = 0.25  # of a drawn colour's components, so that it shows on black
MOST_DISTRACTORS = 16  # for which a scene has room
SMALLEST, LARGEST = 0.03, 0.3  # edges of a distractor, of the frame's height
NUMBERS = 8  # of a distractor in a scene


@dataclass(frozen=True)
class Surroundings:
    """What is drawn of one episode beside the moving parts; the renderer keeps a background for each.

    Args:
        light: factor on the headlight's ambient and diffuse parts.
        shift: pixels by which the picture moves right and up.
        distractors: of each the centre right and up and the two edges, all over the frame's height and from its middle,
            the angle in radians, RGB.
        occluder: of the bar in front its left edge and its width in pixels, RGB; None for none.
    """

    light: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)
    distractors: tuple[tuple[float, ...], ...] = ()
    occluder: tuple[int, int, float, float, float] | None = None


PLAIN = Surroundings()


@dataclass(frozen=True)
class Appearance:
    """What is drawn anew for each device and episode; the defaults draw nothing.

    Args:
        colors: draw the colour of every moving part.
        light: least and greatest factor on the headlight's ambient and diffuse parts.
        shift_pixels: the camera's picture moves by at most so many pixels, fractions of them too, to either side, and
            up or down. Where nothing in the picture stands still, a shift to the side cannot be told from a machine
            that stands elsewhere.
        distractors: boxes of random colour, size, place and angle behind all that moves.
        occluder_pixels: width of an upright bar of random colour and place in front of all that moves; 0 for none.

    Raises:
        ValueError: a number is negative, a range ends before it begins, or there are more than 16 distractors.
    """

    colors: bool = False
    light: tuple[float, float] = (1.0, 1.0)
    shift_pixels: tuple[float, float] = (0.0, 0.0)
    distractors: int = 0
    occluder_pixels: int = 0

    def __post_init__(self) -> None:
        (low, high), (right, up) = self.light, self.shift_pixels
        at_least(0, occluder_pixels=self.occluder_pixels, **{"light[0]": low})
        at_least(0, **{"shift_pixels[0]": right, "shift_pixels[1]": up})
        at_least(low, **{"light[1]": high})
        within(0, MOST_DISTRACTORS, distractors=self.distractors)

    def draw(self, seed: int, device: np.ndarray, episode: np.ndarray) -> np.ndarray:
        """The numbers [N, k] in which a scene carries the surroundings; k is 0 where they are plain."""
        low, high = self.light
        unlike = (low, high) != (1, 1) or any(self.shift_pixels) or self.distractors or self.occluder_pixels
        parts = [
            low + (high - low) * uniforms(seed, LIGHT, device, episode, count=1),
            np.array(self.shift_pixels) * (2 * uniforms(seed, SHIFT, device, episode, count=2) - 1),
        ]
        for number in range(self.distractors):
            drawn = uniforms(seed, DISTRACTOR + number, device, episode, count=NUMBERS)
            centre, size, angle, color = np.split(drawn, (2, 4, 5), axis=-1)
            parts += [centre, SMALLEST + (LARGEST - SMALLEST) * size, np.pi * angle, bright(color)]
        if self.occluder_pixels:
            place, color = np.split(uniforms(seed, OCCLUDER, device, episode), (1,), axis=-1)
            parts += [place, bright(color)]
        return np.concatenate(parts if unlike else [parts[0][..., :0]], axis=-1)

    def surroundings(self, numbers: np.ndarray, width: int, height: int) -> Surroundings:
        """What the ``numbers`` [k] of a scene say, for frames of ``width`` x ``height`` pixels."""
        if self.occluder_pixels > width:
            raise ValueError(f"occluder_pixels is {self.occluder_pixels}; the frame is {width} pixels wide.")
        light, right, up, *rest = numbers.tolist()
        boxes = [tuple(rest[NUMBERS * box : NUMBERS * (box + 1)]) for box in range(self.distractors)]
        distractors = tuple(((x - 0.5) * width / height, y - 0.5, *others) for x, y, *others in boxes)
        occluder = None
        if self.occluder_pixels:
            place, *color = rest[NUMBERS * self.distractors :]
            occluder = (round(place * (width - self.occluder_pixels)), self.occluder_pixels, *color)
        return Surroundings(light, (right, up), distractors, occluder)


def bright(drawn: np.ndarray) -> np.ndarray:
    """Colours of uniform numbers in [0, 1] that show on black."""
    return DARKEST + (1.0 - DARKEST) * drawn
