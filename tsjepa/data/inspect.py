"""``tsjepa inspect``: what a stranger's file holds, whether it can be used, and the command that imports it."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from tsjepa.data.clock import typical_interval
from tsjepa.data.import_plan import Plan, plan_import
from tsjepa.data.readers import Episode, Recording, Skipped, Streams, UnknownFormat, open_recording
from tsjepa.data.readers.episode import all_of, read_pictures
from tsjepa.data.report import coding_notes, lag_note

LOOK_S = 2.5  # for opening episodes; a recording of thousands is judged by its first ones
LISTED = 12
LOOKED_AT = 24  # pictures of the first episode that are compared


def inspect_recording(
    path: str,
    camera: str | None = None,
    action: list[str] | str | None = None,
    state: list[str] | str | None = None,
    time: str | None = None,
    rate_hz: float | None = None,
    reader: str | None = None,
) -> dict:
    """Prints format, episodes, streams, faults and the import command of a recording or a radio trace.

    Files are trusted over metadata, nothing pickled is read, and no picture is decoded but a few of the first episode.

    Args:
        path: file or folder.
        camera: image stream to take.
        action: columns, keys or topics of the commands, where their names do not say it; several with commas between.
        state: the same of the state.
        time: column or key of the rows' times; its unit may stand behind it, as in 'time(ms)', where its name has none.
        rate_hz: pictures a second, where neither pictures nor rows have times.
        reader: class path of a reader of your own.

    Returns:
        What was printed, as plain values.

    Raises:
        FileNotFoundError, ValueError: there is nothing that can be used; one sentence.
    """
    try:
        recording = Looked(open_recording(path, Streams(camera, action, state, time, rate_hz), reader))
    except UnknownFormat:
        if (report := _trace(path)) is None:
            raise
        result, said = report
        print(said)
        return result
    plan = plan_import(recording)
    first = plan.parts[0].episode
    longest = max(len(part.piece.frame) for part in plan.parts)
    words = ["tsjepa", "import", path, f"data/{Path(path).resolve().name}"]
    words += ["--slots", str(min(100, longest - 1))] if longest <= 100 else []
    words += ["--camera", camera or recording.camera] if camera or len(recording.cameras) > 1 else []
    for option, value in (("action", action), ("state", state)):
        words += [f"--{option}", value if isinstance(value, str) else ",".join(value)] if value else []
    for option, value in (("time", time), ("rate_hz", rate_hz), ("reader", reader)):
        words += [f"--{option}", str(value)] if value else []
    result = {
        "format": recording.format,
        "cameras": recording.cameras,
        "others": getattr(recording.recording, "others", []),
        "episodes": [_episode(episode, plan) for episode in recording.seen],
        "streams": _streams(recording, plan),
        "slot_s": plan.slot,
        "offset_s": float(np.median(plan.offsets)),
        "lag_slots": plan.lag,
        "skipped": [{"name": entry.name, "reason": entry.reason, "count": entry.count} for entry in plan.skipped],
        "notes": [*plan.notes, *coding_notes(first.frames), *_still(first), lag_note(plan), *recording.cut_short],
        "command": shlex.join(words),
    }
    print(_text(path, result))
    return result


def _trace(path: str) -> tuple[dict, str] | None:
    """The report on a log of a radio link or a folder of them, as values and as text; None where it is none."""
    from tsjepa.radio import trace_import  # with it comes torch, which takes seconds

    try:
        logs, skipped = trace_import.read_logs(Path(path), {}, None)
    except ValueError:
        return None
    words = ["tsjepa", "trace", "import", path, f"{Path(path).resolve().stem}.parquet"]
    devices = [trace_import.describe(name, log) for name, log in logs.items()]
    result = {"devices": devices, "skipped": skipped, "command": shlex.join(words)}
    return result, trace_import.text(result) + _import_with(result)


def _import_with(result: dict) -> str:
    return f"\nimport it with\n  {result['command']}"


class Looked:
    """A recording of which only as many episodes are opened as a few seconds allow."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self.seen, self.cut_short = recording, [], []
        self.format, self.rate_hz = recording.format, recording.rate_hz
        self.cameras, self.notes = recording.cameras, recording.notes

    @property
    def camera(self) -> str:
        """The image stream that was taken."""
        return getattr(self.recording, "camera", None) or self.cameras[0]

    def episodes(self) -> Iterator[Episode | Skipped]:
        """Episodes as the recording gives them, until the time is up."""
        end = time.monotonic() + LOOK_S
        for item in all_of(self.recording):
            if self.seen and time.monotonic() > end:
                self.cut_short.append(
                    f"Only the first {len(self.seen)} episodes were opened, to be quick; an import reads them all."
                )
                return
            yield item
            if isinstance(item, Episode):
                self.seen.append(item)


def _episode(episode: Episode, plan: Plan) -> dict:
    pieces = [len(part.piece.frame) for part in plan.parts if part.episode is episode]
    return {
        "name": episode.name,
        "pictures": episode.frames.count,
        "rows": len(episode.action),
        "rate_hz": measured_rate(episode.frames.times if episode.frames.times is not None else episode.times),
        "pieces": pieces,
    }


def measured_rate(times: np.ndarray | None) -> float | None:
    """Typical rate of a stream with these times (seconds), 1/s; None where they are not known."""
    interval = None if times is None else typical_interval(times)
    return None if interval is None else 1 / interval


def _streams(recording: Recording, plan: Plan) -> list[dict]:
    first = plan.parts[0].episode
    frames = first.frames
    streams = [
        {
            "name": "pixels",
            "shape": [frames.height, frames.width, 3],
            "dtype": "uint8",
            "coding": frames.coding,
            "rate_hz": measured_rate(frames.times),
            "claimed_hz": recording.rate_hz,
        }
    ]
    for kind, names, units in (
        ("action", plan.action_names, plan.action_units),
        ("state", plan.state_names, plan.state_units),
    ):
        values = [getattr(part, kind) for part in plan.parts if getattr(part, kind) is not None]
        if not values:
            continue
        low = np.min([np.nanmin(part, axis=0) for part in values], axis=0)
        high = np.max([np.nanmax(part, axis=0) for part in values], axis=0)
        streams.append(
            {
                "name": kind,
                "shape": [len(names)],
                "dtype": "float32",
                "rate_hz": measured_rate(first.times),
                "claimed_hz": recording.rate_hz,
                "columns": [
                    {"name": name, "unit": unit, "low": float(lowest), "high": float(highest),
                     "constant": bool(lowest == highest)}
                    for name, unit, lowest, highest in zip(names, units, low, high, strict=True)
                ],
            }
        )  # fmt: skip
    return streams


def _still(episode: Episode) -> list[str]:
    """Whether the first pictures change."""
    try:
        pictures = read_pictures(episode.frames, np.arange(min(LOOKED_AT, episode.frames.count)))
    except ValueError as error:
        return [str(error)]
    finally:
        episode.frames.close()
    same = sum(np.array_equal(one, other) for one, other in pairwise(pictures))
    return [f"{same} of the first {len(pictures)} pictures are the same as the one before."] if same else []


def _text(path: str, result: dict) -> str:
    lines = [f"{path}: {result['format']}", f"{len(result['episodes'])} episodes that can be read"]
    for episode in result["episodes"][:LISTED]:
        rate = f"{episode['rate_hz']:.4g} Hz" if episode["rate_hz"] else "no times"
        pieces = f", in pieces of {', '.join(map(str, episode['pieces']))}" if len(episode["pieces"]) > 1 else ""
        lines.append(f"  {episode['name']}: {episode['pictures']} pictures, {episode['rows']} rows, {rate}{pieces}")
    if len(result["episodes"]) > LISTED:
        lines.append(f"  ... and {len(result['episodes']) - LISTED} more")
    lines.append("streams")
    for stream in result["streams"]:
        measured = f"{stream['rate_hz']:.4g}" if stream["rate_hz"] else "unknown"
        claimed = f"{stream['claimed_hz']:g}" if stream["claimed_hz"] else "nothing"
        lines.append(
            f"  {stream['name']}: {stream['shape']} {stream.get('coding', stream['dtype'])}, {measured} Hz measured, "
            f"{claimed} claimed"
        )
        for column in stream.get("columns", [])[:LISTED]:
            span = (
                f"constant at {column['low']:.4g}"
                if column["constant"]
                else f"{column['low']:.4g} to {column['high']:.4g}"
            )
            lines.append(f"    {column['name']} [{column['unit']}]: {span}")
        if len(stream.get("columns", [])) > LISTED:
            lines.append(f"    ... and {len(stream['columns']) - LISTED} more")
    if result["others"]:
        more = f", ... ({len(result['others'])})" if len(result["others"]) > LISTED else ""
        lines.append(f"also there: {', '.join(result['others'][:LISTED])}{more}")
    lines += [f"note     {note}" for note in result["notes"]]
    lines += [f"skipped  {entry['name']}: {entry['reason']}" for entry in result["skipped"]]
    return "\n".join(lines) + _import_with(result)
