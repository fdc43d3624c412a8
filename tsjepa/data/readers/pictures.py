"""Pictures that are files, coded bytes or a plain array."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from tsjepa.data.readers.episode import Frames, check_picture_size

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
    """

    def __init__(
        self, count: int, fetch: Callable[[int], tuple[bytes, str]], coding: str, times: np.ndarray | None = None
    ) -> None:
        self.count, self.fetch, self.coding, self.times = count, fetch, coding, times
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


def picture_files(files: Sequence[Path], times: np.ndarray | None = None) -> CodedPictures:
    """Picture files in the order given."""
    return CodedPictures(
        len(files), lambda index: (files[index].read_bytes(), files[index].name), files[0].suffix[1:].lower(), times
    )


class ArrayPictures(Frames):
    """Pictures of an array that is read in slices (HDF5 data set, memory map).

    Args:
        array: [N, H, W, 3], [N, 3, H, W], [N, H, W] or [N, H, W, 1]; uint8, or float in 0..1.
        first, count: the part of it that is meant.
        times: seconds [count], or None.
    """

    def __init__(self, array, first: int = 0, count: int | None = None, times: np.ndarray | None = None) -> None:
        self.array, self.first, self.times = array, first, times
        self.count = len(array) - first if count is None else max(0, min(count, len(array) - first))
        shape = tuple(array.shape[1:])
        self.channels_first = len(shape) == 3 and shape[0] in (1, 3) and shape[2] not in (1, 3)
        if len(shape) not in (2, 3) or (len(shape) == 3 and shape[0 if self.channels_first else 2] not in (1, 3)):
            raise ValueError(f"an array of shape {tuple(array.shape)} holds no pictures.")
        self.height, self.width = shape[1:] if self.channels_first else shape[:2]
        check_picture_size(self.width, self.height, "the array")
        self.coding = "raw"

    def read(self, indices: Sequence[int] | np.ndarray) -> np.ndarray:
        # a data set of HDF5 wants rising indices, each once
        places, order = np.unique(np.asarray(indices, dtype=np.int64), return_inverse=True)
        return as_rgb(np.asarray(self.array[self.first + places]), self.channels_first)[order]


def as_rgb(pictures: np.ndarray, channels_first: bool = False) -> np.ndarray:
    """uint8 [N, H, W, 3] of pictures [N, H, W], [N, H, W, 1 or 3] or [N, 1 or 3, H, W], uint8 or float in 0..1."""
    if pictures.dtype != np.uint8:
        if pictures.dtype.kind == "f" and np.nanmax(pictures, initial=0) <= 1:
            pictures = pictures * 255
        pictures = np.nan_to_num(pictures).round().clip(0, 255).astype(np.uint8)
    if channels_first:
        pictures = pictures.transpose(0, 2, 3, 1)
    if pictures.ndim == 3:
        pictures = pictures[..., None]
    return np.repeat(pictures, 3, axis=-1) if pictures.shape[-1] == 1 else pictures
