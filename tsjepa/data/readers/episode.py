"""What every reader yields, whatever the file format: pictures, commands and their times."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from tsjepa.support.foreign import reason

MOST_PIXELS = 8192 * 8192  # of one picture: a header that claims more is damaged, and its picture would fill the memory


class Frames(ABC):
    """Pictures of one episode, decoded when they are asked for.

    Attributes:
        count: pictures that are there, counted in the file and not taken from its header.
        height, width: pixels, after a rotation flag.
        times: seconds of the file's own clock [count], or None where it has none.
        coding: codec and chroma, such as "h264 yuv420p", or "raw".
    """

    count: int
    height: int
    width: int
    times: np.ndarray | None
    coding: str

    @abstractmethod
    def read(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        """Pictures uint8 [N, H, W, 3] (RGB); cheap for indices that rise.

        Raises:
            ValueError: one of them cannot be decoded.
        """

    def close(self) -> None:  # noqa: B027
        """Frees what decoding needs; the next ``read`` opens it again."""


@dataclass
class Episode:
    """One episode of a recording.

    Attributes:
        name: how the recording calls it.
        frames: its pictures.
        action: commands [R, m] float32; NaN where the recording has none.
        action_names, action_units: of the m columns; "unknown" where the recording does not say.
        state: measurements [R, n] float32, or None.
        times: seconds of the rows' own clock [R], or None.
        paired: the format says that row i belongs to picture i.
        notes: what is odd about it, one sentence each.

    Raises:
        ValueError: commands, states and times are not equally many, or a row has several times.
    """

    name: str
    frames: Frames
    action: np.ndarray
    action_names: list[str]
    action_units: list[str]
    state: np.ndarray | None = None
    state_names: list[str] = field(default_factory=list)
    state_units: list[str] = field(default_factory=list)
    times: np.ndarray | None = None
    paired: bool = False
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        for what, column in (("states", self.state), ("times", self.times)):
            if column is not None and len(column) != len(self.action):
                raise ValueError(f"it has {len(self.action)} commands and {len(column)} {what}.")
        if self.times is not None and self.times.ndim != 1:
            raise ValueError(f"its times are of the shape {self.times.shape}; there is one a row.")


@dataclass
class Skipped:
    """An episode (or several) that cannot be used: its name, and one sentence why."""

    name: str
    reason: str
    count: int = 1


@dataclass
class Streams:
    """Which of a recording's streams are wanted; None takes what the format or the only candidate says.

    Args:
        camera: image stream, by name, key or topic.
        action: columns, keys or topics of the command, as a list or with commas between them.
        state: the same of the state.
        time: column or key of the rows' times; its unit may stand behind it, as in 'time(ms)', where its name has none.
        rate_hz: pictures a second, for formats without times.
    """

    camera: str | None = None
    action: list[str] | str | None = None
    state: list[str] | str | None = None
    time: str | None = None
    rate_hz: float | None = None

    def __post_init__(self) -> None:
        for kind in ("action", "state"):
            if isinstance(value := getattr(self, kind), str):
                setattr(self, kind, [name.strip() for name in value.split(",")])
        if self.rate_hz is not None and not 0 < self.rate_hz < math.inf:
            raise ValueError(f"rate_hz is {self.rate_hz:g}: it is pictures a second, such as 20.")


class Recording(Protocol):
    """A reader: a class built from (path, :class:`Streams`), which reads no picture before it is asked for one.

    Attributes:
        format: name and version, such as "LeRobot v2.1".
        rate_hz: pictures a second as the metadata claim, or None.
        cameras: image streams that are there.
        others: further streams that are there and not taken, by name.
        notes: where files and metadata disagree and what is missing, one sentence each.
    """

    format: str
    rate_hz: float | None
    cameras: list[str]
    others: list[str]
    notes: list[str]

    def __init__(self, path: Path, streams: Streams) -> None: ...

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether ``path`` looks like this format; opens no data."""

    def episodes(self) -> Iterator[Episode | Skipped]:
        """Every episode in its order, one at a time."""


def attempt(name: str, read: Callable[[], Episode]) -> Episode | Skipped:
    """``read()``, or why it failed: libraries that meet a damaged file raise whatever they like."""
    try:
        return read()
    except (MemoryError, ModuleNotFoundError):
        raise
    except Exception as error:
        return Skipped(name, reason(error))


def all_of(recording: Recording) -> Iterator[Episode | Skipped]:
    """The recording's episodes; a reader that fails on the way ends them with an entry that says so."""
    episodes = iter(recording.episodes())
    while True:
        try:
            item = next(episodes)
        except StopIteration:
            return
        except (MemoryError, ModuleNotFoundError):
            raise
        except Exception as error:
            yield Skipped("the rest", reason(error))
            return
        yield item


def read_pictures(frames: Frames, indices: Sequence[int] | np.ndarray) -> np.ndarray:
    """``frames.read(indices)``, with whatever a library raises on a damaged file as one kind of error.

    Raises:
        ValueError: one of them cannot be decoded.
    """
    try:
        return frames.read(indices)
    except (MemoryError, ModuleNotFoundError, ValueError):
        raise
    except Exception as error:
        raise ValueError(reason(error)) from error


def ranges(numbers: Sequence[int], most: int = 6) -> str:
    """Numbers as "0-28, 31, 33-99"; the first ``most`` runs of them."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    words = [str(first) if first == last else f"{first}-{last}" for first, last in runs]
    return ", ".join(words[:most]) + (", ..." if len(words) > most else "")


def check_picture_size(width: int, height: int, name: str) -> None:
    """Raises ValueError for sizes that no camera has."""
    if width < 1 or height < 1 or width * height > MOST_PIXELS:
        raise ValueError(f"{name} claims pictures of {width} x {height} pixels; it is damaged.")
