"""Writing what devices, radio and controller do, slot by slot, as a file that the Rerun viewer opens.

Needs the package rerun-sdk (``pip install 'tsjepa[record]'``), which is imported when a recording is begun. Everything
in a file lies on one timeline, ``time`` in seconds, and every device has the same entities below its name:

    camera, belief   pictures: what the camera sees, and what the controller takes for it
    state, command   numbers with the names of the plant's spec; the command is the one that was applied
    age              slots since the controller heard of the device
    radio            sent and delivered, 0 or 1
    score            of the slot
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tsjepa.support.spec import PlantSpec

if TYPE_CHECKING:
    import rerun

TIME = "time"
SERIES = ("state", "command", "age", "radio", "score")
SHOWN = 24  # devices of a run whose pictures have a place of their own when the file is opened
DETAILED = 2  # devices of a run whose curves do


def check_recording(path: str | Path) -> None:
    """Says before a long run what would keep it from being recorded.

    Raises:
        ValueError: the file's name does not end in ``.rrd``.
        ModuleNotFoundError: rerun-sdk is not installed.
    """
    if Path(path).suffix != ".rrd":
        raise ValueError(f"record {str(path)!r} must name a file that ends in .rrd.")
    _library()


@contextmanager
def recording(path: str | Path, recording_id: str | None = None) -> Iterator[rerun.RecordingStream]:
    """A stream to write with :func:`record_slot`; the file is whole when the block is left.

    Args:
        path: of the ``.rrd`` file. It grows as ``.partial`` and replaces at the end what was there.
        recording_id: files with the same one are shown as one recording, such as those of a device and its controller.

    Raises:
        ValueError, ModuleNotFoundError: as :func:`check_recording`.
        OSError: the file cannot be written.
    """
    check_recording(path)
    rr, path = _library(), Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.touch()  # an OSError says what is wrong with the place
    stream = rr.RecordingStream("tsjepa", recording_id=recording_id)
    rr.set_log_time_enabled(False, recording=stream)
    stream.save(partial)
    try:
        yield stream
    finally:
        stream.flush()
        stream.disconnect()
    os.replace(partial, path)


def introduce(stream: rerun.RecordingStream, name: str, spec: PlantSpec) -> None:
    """Gives the curves of the device ``name`` their names, with the units of its plant."""
    names = {
        "state": [f"{label} [{unit}]" for label, unit in zip(spec.state_names, spec.state_units, strict=True)],
        "command": [" ".join(parts) for parts in zip(spec.action_names, spec.action_units, strict=False)],
        "age": ["age [slots]"],
        "radio": ["sent", "delivered"],
        "score": ["score"],
    }
    for entity, labels in names.items():
        stream.log(f"{_path(name)}/{entity}", _library().SeriesLines(names=labels), static=True)


def record_slot(
    stream: rerun.RecordingStream,
    name: str,
    seconds: float,
    pictures: Mapping[str, np.ndarray] | None = None,
    numbers: Mapping[str, float | Sequence[float] | np.ndarray] | None = None,
) -> None:
    """Writes what is known of one device in one slot; what is not known is left out.

    Args:
        stream: of :func:`recording`.
        name: of the device; parts of it that are separated by "/" are levels, such as "round_robin/device 3".
        seconds: begin of the slot on the common timeline.
        pictures: by entity ("camera", "belief"), uint8 [H, W, 3] RGB; kept without loss.
        numbers: by entity (:data:`SERIES`), one number or [n].
    """
    import cv2

    rr, path = _library(), _path(name)
    stream.set_time(TIME, duration=seconds)
    for entity, picture in (pictures or {}).items():
        contents = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()
        stream.log(f"{path}/{entity}", rr.EncodedImage(contents=contents, media_type="image/png"))
    for entity, values in (numbers or {}).items():
        stream.log(f"{path}/{entity}", rr.Scalars(np.atleast_1d(np.asarray(values, np.float64))))


def arrange(stream: rerun.RecordingStream, runs: Mapping[str, Sequence[str]], believes: bool) -> None:
    """Lays the file out for whoever opens it: a tab for each run, pictures above, curves of the first devices below.

    Args:
        stream: of :func:`recording`.
        runs: names of each run's devices, by what its tab is called.
        believes: whether there are pictures of the belief beside those of the camera.
    """
    import rerun.blueprint as rrb

    seen = ("camera", "belief") if believes else ("camera",)

    def pictures(device: str) -> Any:
        views = [rrb.Spatial2DView(origin=f"{_path(device)}/{entity}", name=f"{device}: {entity}") for entity in seen]
        return rrb.Horizontal(*views) if believes else views[0]

    def curves(device: str) -> Any:
        views = [rrb.TimeSeriesView(origin=f"{_path(device)}/{entity}", name=entity) for entity in SERIES]
        return rrb.Horizontal(*views, name=device)

    tabs = [
        rrb.Vertical(
            rrb.Grid(*map(pictures, devices[:SHOWN])), *map(curves, devices[:DETAILED]), row_shares=[3, 1, 1], name=run
        )
        for run, devices in runs.items()
    ]
    stream.send_blueprint(rrb.Blueprint(rrb.Tabs(*tabs), collapse_panels=True))


def _path(name: str) -> list[str] | str:
    """The entity path of a name, whose spaces Rerun wants escaped."""
    rr = _library()
    return "/".join(rr.escape_entity_path_part(part) for part in name.split("/"))


def _library() -> Any:
    try:
        import rerun
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("A recording needs the package rerun-sdk: pip install 'tsjepa[record]'.") from error
    return rerun
