"""What a device and a controller do as files for the Rerun viewer, which shows the two as one recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from tsjepa.support.recording import introduce, record_slot, recording
from tsjepa.support.spec import PlantSpec

Record = Callable[[int, int, Mapping[str, np.ndarray], Mapping[str, np.ndarray | float]], None]
"""Writes pictures and numbers, by entity, of a device in a slot."""

RECORDING_ID = "tsjepa live"


@contextmanager
def recorded(path: str | None, spec: PlantSpec, devices: Sequence[int]) -> Iterator[Record | None]:
    """What writes the slots of ``devices`` to the ``.rrd`` file ``path``; None where no file is wanted.

    Slots are those of the device, also at the controller, so that both files have one timeline.

    Raises:
        ValueError, ModuleNotFoundError, OSError: as :func:`tsjepa.support.recording.recording`.
    """
    if path is None:
        yield None
        return
    with recording(path, RECORDING_ID) as stream:
        for device in devices:
            introduce(stream, f"device {device}", spec)
        yield lambda device, slot, pictures, numbers: record_slot(
            stream, f"device {device}", slot * spec.slot, pictures, numbers
        )
