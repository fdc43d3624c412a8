"""``tsjepa import``: a data set from a recording that others made."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from tsjepa.data.cutting import Taken, split_trajectories
from tsjepa.data.import_plan import Part, Plan, plan_import
from tsjepa.data.lag import Lag, command_lag, common_lag
from tsjepa.data.readers import Frames, Skipped, Streams, open_recording
from tsjepa.data.readers.episode import read_pictures
from tsjepa.data.report import import_report, import_table
from tsjepa.data.storage import METADATA
from tsjepa.data.writing import write_data_set
from tsjepa.support.checks import at_least, within
from tsjepa.support.files import refuse_to_replace
from tsjepa.support.foreign import reason
from tsjepa.support.spec import PlantSpec

BLOCK_BYTES = 32 << 20  # of decoded pictures in memory at a time


def import_recording(
    path: str,
    output: str,
    size: tuple[int, int] | None = (64, 64),
    slot: float | None = None,
    slots: int = 100,
    validation: float = 0.1,
    test: float = 0.1,
    camera: str | None = None,
    action: list[str] | str | None = None,
    state: list[str] | str | None = None,
    time: str | None = None,
    rate_hz: float | None = None,
    offset: float | Literal["auto"] = "auto",
    strict: bool = False,
    reader: str | None = None,
    seed: int = 0,
    overwrite: bool = False,
) -> Path:
    """Makes a data set of a recording: trajectories of ``slots`` commands and ``slots`` + 1 pictures.

    An episode is cut into trajectories; the last one overlaps its predecessor, so that nothing is lost. What is shorter
    or cannot be read is named, counted and left out. Pictures are read as they are needed, never all at once.

    Args:
        path: file or folder of the recording; ``tsjepa inspect`` says what is in it.
        output: folder of the data set.
        size: height and width of the stored pictures, or null for the recording's own.
        slot: seconds to resample to; the recording's own interval when null.
        slots: T; a trajectory has T commands and T + 1 pictures.
        validation: share of the episodes that is held out for validation.
        test: share of the episodes that is held out for tests.
        camera: image stream to take.
        action: columns, keys or topics of the commands, where their names do not say it; several with commas between.
        state: the same of the state.
        time: column or key of the rows' times; its unit may stand behind it, as in 'time(ms)', where its name has none.
        rate_hz: pictures a second, where neither pictures nor rows have times.
        offset: seconds by which the clock of the rows is ahead of that of the pictures; found when auto.
        strict: refuse the recording if anything of it cannot be used.
        reader: class path of a reader of your own.
        seed: of the draw of held-out episodes.
        overwrite: replace the data set that is there.

    Raises:
        FileNotFoundError, FileExistsError, ValueError: one sentence that says what to mend.
    """
    at_least(1, slots=slots)
    at_least(0, seed=seed)
    within(0, 0.9, validation=validation, test=test, both=validation + test)
    if slot is not None and not 1e-6 <= slot <= 3600:
        raise ValueError(f"slot is {slot}; it is a time in seconds, such as 0.02.")
    if size is not None and not all(4 <= side <= 4096 for side in size):
        raise ValueError(f"size is {size}; it is height and width in pixels, such as [64, 64].")
    folder = Path(output)
    if folder.exists() and not overwrite:
        raise FileExistsError(f"{folder} exists; pass --overwrite true to replace it, or choose another folder.")
    refuse_to_replace(folder, "data set", METADATA)
    recording = open_recording(path, Streams(camera, action, state, time, rate_hz), reader)
    plan = plan_import(recording, slot, None if offset == "auto" else offset)
    parts = _long_enough(plan, slots)
    if strict:
        _refuse(plan.skipped)
    folder.parent.mkdir(parents=True, exist_ok=True)
    raw = folder.with_name(folder.name + ".pictures.partial")
    try:
        with raw.open("wb") as file:
            taken = list(_decode(parts, plan, size, slots, file))
        if strict:
            _refuse(plan.skipped)
        if not taken:
            raise ValueError(f"No picture can be used: {plan.skipped[-1].name}: {plan.skipped[-1].reason}")
        splits = split_trajectories(taken, raw, size or taken[0][2], slots, validation, test, seed)
        used = [part for part, _, _ in taken]
        report = import_report(plan, used, recording.format, splits)
        metadata = {
            "made_by": "tsjepa import",
            "source": {"format": recording.format, "name": Path(path).resolve().name},
            "splits": {name: {"episodes": len(trajectories), "slots": slots} for name, trajectories in splits.items()},
            "slots": slots,
            "seed": seed,
            "spec": _spec(plan, used, size or taken[0][2]).to_dict(),
        }
        write_data_set(folder, splits, metadata, {"import.json": json.dumps(report, indent=2) + "\n"})
    finally:
        raw.unlink(missing_ok=True)
    print(import_table(report, folder))
    return folder


def _refuse(skipped: list[Skipped]) -> None:
    if skipped:
        raise ValueError(
            f"{len(skipped)} parts of the recording cannot be used ({skipped[0].name}: {skipped[0].reason}) and strict "
            "is true: nothing is imported."
        )


def _long_enough(plan: Plan, slots: int) -> list[Part]:
    """The pieces that make a trajectory; the others are counted as skipped.

    Raises:
        ValueError: none does.
    """
    parts = []
    for part in plan.parts:
        frames = len(part.piece.frame)
        if frames > slots:
            parts.append(part)
        else:
            plan.skipped.append(Skipped(part.name, f"{frames} pictures are too few for {slots} slots."))
    if not parts:
        longest = max(len(part.piece.frame) for part in plan.parts)
        raise ValueError(
            f"The longest piece has {longest} pictures and {slots + 1} are needed: say --slots {longest - 1}."
        )
    return parts


def _decode(parts: list[Part], plan: Plan, size: tuple[int, int] | None, slots: int, file) -> Iterator[Taken]:
    """Writes the resized pictures of every part one after the other; yields parts, their first byte and size."""
    own: tuple[int, int] | None = None
    lags: list[Lag | None] = []
    for part in parts:
        frames, start, written = part.episode.frames, file.tell(), 0
        height, width = size or (frames.height, frames.width)
        own = own or (height, width)
        still = moving = 0
        motion: list[float] = []
        last = small = None
        try:
            if (height, width) != own:
                raise ValueError(
                    f"its pictures are {height} x {width}, those of the first episode {own[0]} x {own[1]}."
                )
            for pictures, wanted in _blocks(frames, part.piece.frame):
                for picture, repeated in zip(pictures, wanted, strict=True):
                    if last is not None and not repeated:
                        same = np.array_equal(picture, last)
                        still, moving = still + same, moving + (not same)
                    last, before, small = picture, small, resize(picture, height, width)
                    if before is not None:
                        motion.append(float(cv2.absdiff(small, before).mean()))
                    file.write(small.tobytes())
                    written += 1
        except ValueError as error:
            plan.skipped.append(Skipped(f"{part.name} from picture {written} on", reason(error)))
        finally:
            frames.close()
        if still and not moving:
            plan.skipped.append(Skipped(part.name, f"its {written} pictures are all the same."))
            written = 0
        plan.still, plan.pictures = plan.still + still, plan.pictures + written
        if plan.lag is None:
            lags.append(command_lag(part.action[: len(motion)], np.array(motion)[:, None], plan.slot, same=False))
        if written <= slots:
            if written:
                plan.skipped.append(Skipped(part.name, f"{written} pictures are too few for {slots} slots."))
            file.seek(start)
            file.truncate()
            continue
        part.piece.frame = part.piece.frame[:written]
        yield part, start, (height, width)
    if plan.lag is None:
        plan.lag = common_lag(lags, [len(part.piece.frame) for part in parts])


def _blocks(frames: Frames, indices: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pictures in blocks, and whether a picture stands there only because the slot is shorter than its interval."""
    step = max(1, BLOCK_BYTES // (frames.height * frames.width * 3))
    repeated = np.diff(indices, prepend=-1) == 0
    for first in range(0, len(indices), step):
        part = slice(first, first + step)
        try:
            pictures = read_pictures(frames, indices[part])
        except ValueError:  # up to the one that fails, they are good
            for place in range(first, min(first + step, len(indices))):
                yield read_pictures(frames, indices[place : place + 1]), repeated[place : place + 1]
            continue
        yield pictures, repeated[part]


def resize(picture: np.ndarray, height: int, width: int) -> np.ndarray:
    """The picture [H, W, 3] with another size, each pixel the mean of what it covers; as it is if it fits."""
    if picture.shape[:2] == (height, width):
        return picture
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _spec(plan: Plan, parts: list[Part], size: tuple[int, int]) -> PlantSpec:
    """The recording's own names, units and measured ranges."""
    used = np.concatenate([part.action[: len(part.piece.frame) - 1] for part in parts])
    low, high = used.min(axis=0), used.max(axis=0)
    # a command that never changed has a range all the same, or nothing could be divided by it
    low, high = np.where(low < high, low, low - 0.5), np.where(low < high, high, high + 0.5)
    states = [part.state[: len(part.piece.frame)] for part in parts if part.state is not None]
    largest = np.max([np.abs(state).max(axis=0) for state in states], axis=0) if states else np.zeros(0)
    return PlantSpec(
        action_low=tuple(low.tolist()),
        action_high=tuple(high.tolist()),
        slot=plan.slot,
        frame=size,
        state_names=tuple(plan.state_names),
        state_units=tuple(plan.state_units),
        state_scale=tuple(np.where(largest > 0, largest, 1.0).tolist()),
        action_names=tuple(plan.action_names),
        action_units=tuple(plan.action_units),
    )
