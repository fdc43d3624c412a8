"""Pictures of one video file, or of a part of it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tsjepa.data.readers.episode import Frames, check_picture_size
from tsjepa.support.foreign import optional, refuse_pointer

SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v")
SEEK_BEYOND = 120  # frames: decoding that many costs more than a jump to the key frame before the wanted one


@dataclass(frozen=True)
class VideoIndex:
    """Stamps of a video's frames in their order of display, in ticks and in seconds, and how they are coded."""

    ticks: np.ndarray
    times: np.ndarray
    height: int
    width: int
    coding: str
    rate_hz: float | None


def video_index(path: Path) -> VideoIndex:
    """Reads every packet's stamp without decoding it, and decodes the first frame for its true size and rotation.

    Raises:
        ValueError: there is no video in the file, or nothing of it can be decoded.
    """
    refuse_pointer(path)
    status = path.stat()
    return _index(path, status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=64)
def _index(path: Path, changed_ns: int, size: int) -> VideoIndex:
    av = optional("av")
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise ValueError(f"{path.name} holds no video.")
            stream = container.streams.video[0]
            check_picture_size(stream.width, stream.height, path.name)
            ticks = [packet.pts for packet in container.demux(stream) if packet.size and not packet.is_discard]
            base, rate = stream.time_base, stream.average_rate
            container.seek(0)
            first = next(container.decode(stream), None)
            if first is None:
                raise ValueError(f"no picture of {path.name} can be decoded.")
            coding = f"{stream.codec_context.codec.canonical_name} {first.format.name}"
            turned = abs(first.rotation) % 180 == 90
            height, width = (first.width, first.height) if turned else (first.height, first.width)
        if any(tick is None for tick in ticks):
            ticks = _decoded_ticks(av, path)
    except av.error.FFmpegError as error:
        raise ValueError(f"{path.name} is no video that can be read ({error.strerror}).") from error
    ticks = np.unique(np.array(ticks, dtype=np.int64))
    return VideoIndex(ticks, ticks * float(base), height, width, coding, float(rate) if rate else None)


def _decoded_ticks(av: object, path: Path) -> list[int]:
    """Stamps from decoding everything, for containers whose packets carry none."""
    with av.open(str(path)) as container:
        return [frame.pts for frame in container.decode(video=0) if frame.pts is not None]


class Video(Frames):
    """``count`` frames of a video file from frame ``first`` on.

    Full-range colour, the colour matrix and a rotation flag are those of the file's header.
    """

    def __init__(self, path: Path, first: int = 0, count: int | None = None) -> None:
        self.path, self.first = path, first
        self.index = video_index(path)
        there = len(self.index.ticks) - first
        self.count = max(0, there if count is None else min(count, there))
        self.height, self.width, self.coding = self.index.height, self.index.width, self.index.coding
        self.times = self.index.times[first : first + self.count]
        if count is not None and self.count:
            self.times = self.times - self.times[0]  # a part of a file: the clock starts with the part
        self._container = self._frames = None
        self._at, self._picture = -1, None

    def read(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        pictures = np.empty((len(indices), self.height, self.width, 3), np.uint8)
        error_class = optional("av").error.FFmpegError
        for place, index in enumerate(indices):
            try:
                pictures[place] = self._picture_at(self.first + int(index))
            except (error_class, StopIteration) as error:
                self.close()
                raise ValueError(f"picture {int(index)} of {self.path.name} cannot be decoded.") from error
        return pictures

    def _picture_at(self, wanted: int) -> np.ndarray:
        if wanted == self._at:
            return self._picture
        tick = int(self.index.ticks[wanted])
        if self._container is None or wanted < self._at or wanted > self._at + SEEK_BEYOND:
            self._seek(tick)
        frame = next(self._frames)
        while frame.pts is None or frame.pts < tick:
            frame = next(self._frames)
        if frame.pts != tick:
            raise StopIteration
        picture = frame.to_ndarray(format="rgb24")
        if frame.rotation:
            picture = np.rot90(picture, frame.rotation // 90)
        if picture.shape[:2] != (self.height, self.width):
            raise ValueError(
                f"{self.path.name} changes its size from {self.width} x {self.height} to "
                f"{picture.shape[1]} x {picture.shape[0]} at picture {wanted - self.first}."
            )
        self._at, self._picture = wanted, picture
        return picture

    def _seek(self, tick: int) -> None:
        av = optional("av")
        if self._container is None:
            self._container = av.open(str(self.path))
        stream = self._container.streams.video[0]
        self._container.seek(tick, stream=stream)
        self._frames = self._container.decode(stream)

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
        self._container = self._frames = None
        self._at, self._picture = -1, None
