"""Pictures that are files, coded bytes or a plain array."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from tsjepa.data.readers.episode import Frames, check_picture_size

CHANNELS = (1, 3, 4)
SAMPLED = 8  # pictures of a recording that tell the range of its numbers
SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff")


def natural(path: Path | str) -> list:
    """Sorting key that puts 2 before 10."""
    name = path.as_posix() if isinstance(path, Path) else path
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name) if part]


def decode_picture(data: bytes, name: str) -> np.ndarray:
    """RGB uint8 [H, W, 3] of a JPEG, PNG, ... (an EXIF rotation is applied).

    Raises:
        ValueError: it cannot be decoded.
    """
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if len(data) else None
    if picture is None:
        raise ValueError(f"{name} is no picture that can be decoded.")
    return picture[..., ::-1]


class CodedPictures(Frames):
    """Pictures that ``fetch(index)`` gives as coded bytes, one by one.

    Args:
        count: how many there are.
        fetch: coded bytes of one picture and the name to use in errors.
        coding: "jpeg", "png", ...
        times: seconds [count], or None.
        release: frees what ``fetch`` keeps; it may be called again.
    """

    def __init__(
        self,
        count: int,
        fetch: Callable[[int], tuple[bytes, str]],
        coding: str,
        times: np.ndarray | None = None,
        release: Callable[[], None] = lambda: None,
    ) -> None:
        self.count, self.fetch, self.coding, self.times, self.release = count, fetch, coding, times, release
        self.height, self.width = decode_picture(*fetch(0)).shape[:2] if count else (0, 0)

    def read(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        pictures = np.empty((len(indices), self.height, self.width, 3), np.uint8)
        for place, index in enumerate(indices):
            data, name = self.fetch(int(index))
            picture = decode_picture(data, name)
            if picture.shape[:2] != (self.height, self.width):
                raise ValueError(
                    f"{name} is {picture.shape[1]} x {picture.shape[0]} pixels, the first picture "
                    f"{self.width} x {self.height}."
                )
            pictures[place] = picture
        return pictures

    def close(self) -> None:
        self.release()


def picture_files(files: Sequence[Path], times: np.ndarray | None = None) -> CodedPictures:
    """Picture files in the order given."""
    return CodedPictures(
        len(files), lambda index: (files[index].read_bytes(), files[index].name), files[0].suffix[1:].lower(), times
    )


class ArrayPictures(Frames):
    """Pictures of an array that is read in slices (HDF5 data set, memory map).

    Args:
        array: [N, H, W, C], [N, C, H, W] or [N, H, W] with 1, 3 or 4 channels (the fourth, alpha, is left out); uint8,
            uint16, or float in 0..255, 0..1 or -1..1, which some of its pictures tell.
        first, count: the part of it that is meant.
        times: seconds [count], or None.
    """

    def __init__(self, array, first: int = 0, count: int | None = None, times: np.ndarray | None = None) -> None:
        self.array, self.first, self.times = array, first, times
        self.count = len(array) - first if count is None else max(0, min(count, len(array) - first))
        shape = tuple(array.shape[1:])
        self.channels_first = len(shape) == 3 and shape[0] in CHANNELS and shape[2] not in CHANNELS
        if len(shape) not in (2, 3) or (len(shape) == 3 and shape[0 if self.channels_first else 2] not in CHANNELS):
            raise ValueError(f"an array of shape {tuple(array.shape)} holds no pictures.")
        self.height, self.width = shape[1:] if self.channels_first else shape[:2]
        check_picture_size(self.width, self.height, "the array")
        self.coding = "raw"
        self.scale, self.shift = 1.0, 0.0
        if array.dtype != np.uint8 and self.count:
            self.scale, self.shift = levels(self._slice(np.linspace(0, self.count - 1, SAMPLED).astype(np.int64)))

    def _slice(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        # a data set of HDF5 wants rising indices, each once
        places, order = np.unique(np.asarray(indices, dtype=np.int64), return_inverse=True)
        return np.asarray(self.array[self.first + places])[order]

    def read(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        pictures = self._slice(indices)
        if pictures.dtype != np.uint8:
            pictures = np.nan_to_num(pictures * self.scale + self.shift).round().clip(0, 255).astype(np.uint8)
        if self.channels_first:
            pictures = pictures.transpose(0, 2, 3, 1)
        if pictures.ndim == 3:
            pictures = pictures[..., None]
        return np.repeat(pictures, 3, axis=-1) if pictures.shape[-1] == 1 else pictures[..., :3]


def levels(pictures: np.ndarray) -> tuple[float, float]:
    """Scale and shift that bring pictures of some other type to 0..255."""
    known = pictures[np.isfinite(pictures)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    if pictures.dtype.kind != "f":
        return (1.0, 0.0) if high <= 255 else (1 / 257, 0.0)
    # interpolation overshoots the ends of 0..1 a little; what is beyond is clipped
    if high > 2:
        return 1.0, 0.0
    return (127.5, 127.5) if low < -0.15 else (255.0, 0.0)
