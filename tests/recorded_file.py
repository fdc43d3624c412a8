"""Reads recordings with Rerun's own reader."""

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
from PIL import Image
from rerun.chunk import RrdReader

TIME = "time"


class RecordedFile:
    """What stands in an ``.rrd`` file.

    Args:
        path: of the file.
    """

    def __init__(self, path: Path):
        reader = RrdReader(path)
        self.blueprints = len(reader.blueprints())
        self.chunks = list(reader.stream())

    def entities(self) -> set[str]:
        """Paths of the entities that change in time."""
        return {chunk.entity_path for chunk in self.chunks if not chunk.is_static}

    def timelines(self) -> set[str]:
        """Names of the timelines on which anything lies."""
        return {name for chunk in self.chunks for name in chunk.timeline_names}

    def numbers(self, entity: str) -> tuple[np.ndarray, np.ndarray]:
        """Seconds [K] and values [K, n] of an entity of scalars."""
        return self._rows(entity, "Scalars:scalars", lambda values: values.as_py())

    def pictures(self, entity: str) -> tuple[np.ndarray, np.ndarray]:
        """Seconds [K] and frames [K, H, W, 3] of an entity of pictures."""
        return self._rows(entity, "EncodedImage:blob", decoded)

    def names(self, entity: str) -> list[str]:
        """Names of an entity's curves."""
        (chunk,) = (chunk for chunk in self.chunks if chunk.is_static and chunk.entity_path == entity)
        return chunk.to_record_batch().column("SeriesLines:names")[0].as_py()

    def _rows(self, entity, component, read):
        rows = []
        for chunk in self.chunks:
            if chunk.entity_path == entity and not chunk.is_static:
                batch = chunk.to_record_batch()
                seconds = batch.column(TIME).cast(pa.int64()).to_numpy() * 1e-9
                rows += zip(seconds, map(read, batch.column(component)), strict=True)
        rows.sort(key=lambda row: row[0])
        return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


def decoded(blob: pa.ListScalar) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(np.asarray(blob.values.flatten(), np.uint8).tobytes())))
