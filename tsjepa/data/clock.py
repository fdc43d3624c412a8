"""Time in recordings: the clocks of rows and pictures, gaps, resampling to the slot."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

GAP = 5  # intervals: a longer pause is no lost picture any more but another piece
PAUSE_S = 1.0  # commands may be sent only when they change: a shorter pause between them is no gap
LISTED = 4  # gaps of an episode that are said one by one
EPSILON = 1e-3  # of a slot: stamps are rounded (float32, milliseconds)


@dataclass
class Clocks:
    """Rows and pictures of an episode on one clock.

    Attributes:
        rows, frames: seconds [R] and [N] on the clock of the pictures.
        paired: row i belongs to picture i.
        interval: median seconds from one picture to the next.
        offset: seconds that the clock of the rows was ahead of that of the pictures.
        breaks: steps [R - 1] at which only the clock of the rows says that something is missing, or None.
        notes: what was found, one sentence each.
    """

    rows: np.ndarray
    frames: np.ndarray
    paired: bool
    interval: float
    offset: float = 0.0
    breaks: np.ndarray | None = None
    notes: list[str] = field(default_factory=list)


@dataclass
class Piece:
    """A part of an episode without a gap: which picture and which row stand in every slot.

    Attributes:
        frame: index of the newest picture in every slot [K].
        row: index of the row whose command is held in every slot [K].
        start: seconds at the first slot.
    """

    frame: np.ndarray
    row: np.ndarray
    start: float


def typical_interval(times: np.ndarray) -> float | None:
    """Median of the steps forward, seconds; None where there are none."""
    steps = np.diff(times)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else None


def stamp_faults(times: np.ndarray, what: str) -> list[str]:
    """One sentence for stamps that repeat and one for stamps that go back."""
    steps, notes = np.diff(times), []
    for fault, word in ((steps == 0, "repeat"), (steps < 0, "go back")):
        if fault.any():
            first = int(np.flatnonzero(fault)[0]) + 1
            notes.append(f"{int(fault.sum())} times of {what} {word} (first at {first}).")
    return notes


def match_clocks(
    row_times: np.ndarray | None,
    frame_times: np.ndarray | None,
    rows: int,
    frames: int,
    paired: bool,
    rate_hz: float | None,
    offset: float | None = None,
) -> Clocks:
    """Puts rows and pictures on the clock of the pictures.

    Where there is a row for every picture (or for all but the last), row i belongs to picture i, and the difference of
    the clocks is the offset; also where the format pairs them and one stream only ends earlier. Where there is not, the
    stamps are taken as those of one clock if they overlap, else both streams are laid together at their starts.

    Args:
        row_times, frame_times: seconds [rows] and [frames], each on its own clock, or None.
        rows, frames: how many there are.
        paired: the format says that row i belongs to picture i.
        rate_hz: pictures a second for streams without times.
        offset: seconds to take from the rows' times, instead of finding them.

    Raises:
        ValueError: there is nothing to go by.
    """
    if not rows or not frames:
        raise ValueError(f"it has {rows} rows and {frames} pictures.")
    pairs = min(rows, frames)
    equally_many = abs(frames - rows) <= 1
    alike = equally_many or (paired and row_times is not None and frame_times is not None)
    notes = []
    for times, what in ((row_times, "rows"), (frame_times, "pictures")):
        if times is not None:
            if not np.isfinite(times).all():
                raise ValueError(f"{int((~np.isfinite(times)).sum())} times of its {what} are no numbers.")
            notes += stamp_faults(times, what)
    if row_times is None and frame_times is None:
        if not rate_hz:
            raise ValueError(
                "neither its rows nor its pictures have times: name the column of the rows' times (--time), or say how "
                "many there are a second (--rate_hz)."
            )
        if not alike:
            raise ValueError(f"it has {rows} rows and {frames} pictures, and no times that tell which go together.")
        clock = np.arange(max(rows, frames)) / rate_hz
        return Clocks(clock[:rows], clock[:frames], alike, 1 / rate_hz)
    if row_times is None or frame_times is None:
        known, others = (row_times, frames) if frame_times is None else (frame_times, rows)
        if not alike:
            raise ValueError(
                f"its {'pictures' if frame_times is None else 'rows'} have no times, and {rows} rows do not go with "
                f"{frames} pictures."
            )
        interval = typical_interval(known) or (1 / rate_hz if rate_hz else None)
        if interval is None:
            raise ValueError("its times do not move forward.")
        beyond = known[-1] + interval * np.arange(1, max(0, others - len(known)) + 1)
        borrowed = np.concatenate([known, beyond])[:others]
        both = (known, borrowed) if frame_times is None else (borrowed, known)
        return Clocks(*both, alike, interval, notes=notes)
    interval = typical_interval(frame_times) or typical_interval(row_times)
    if interval is None:
        raise ValueError("its times do not move forward.")
    if offset is not None:
        return Clocks(row_times - offset, frame_times, False, interval, offset, notes=notes)
    if alike:
        ahead = row_times[:pairs] - frame_times[:pairs]
        found = float(np.median(ahead))
        steps = np.diff(row_times[:pairs])
        breaks = (steps < 0) | (steps > GAP * interval)
        drift = float(np.polyfit(np.arange(pairs), ahead, 1)[0] * pairs) if pairs > 2 and not breaks.any() else 0.0
        if equally_many or abs(drift) <= interval:
            if abs(drift) > interval / 2:
                notes.append(
                    f"the clocks of rows and pictures drift apart by {1000 * drift:.0f} ms over the episode; row i is "
                    "taken with picture i."
                )
            if abs(found) > interval / 20:
                notes.append(offset_sentence(found, interval))
            return Clocks(frame_times[:pairs], frame_times, True, interval, found, breaks, notes)
        notes.append(f"{frames} pictures and {rows} rows come at different rates; they are matched by their times.")
    common = min(row_times.max(), frame_times.max()) - max(row_times.min(), frame_times.min())
    shorter = min(np.ptp(row_times), np.ptp(frame_times))
    found = 0.0 if common > shorter / 2 else float(row_times.min() - frame_times.min())
    if found:
        notes.append(f"the clocks of rows and pictures have nothing in common; their starts are laid together "
                     f"({found:+.3f} s).")  # fmt: skip
    return Clocks(row_times - found, frame_times, False, interval, found, notes=notes)


def offset_sentence(offset: float, interval: float) -> str:
    """How far the rows' clock is ahead of the pictures'."""
    return f"the clock of the rows is {offset:+.3f} s ({offset / interval:+.1f} frames) against that of the pictures."


def cut(clocks: Clocks, usable: np.ndarray, slot: float | None, row_needed: bool) -> tuple[list[Piece], list[str]]:
    """Cuts an episode at its gaps and resamples every piece to the slot.

    In every slot stands the newest picture that was taken by then, never a later one, and the command of the newest
    row, held. Where ``slot`` is None and the pictures come evenly, they are taken as they are.

    Args:
        clocks: of the episode.
        usable: whether a row has a command (and state) [R].
        slot: seconds, or None for the recording's own interval.
        row_needed: the last picture of a piece needs a row (for its state) as well.

    Returns:
        The pieces in the order of time, and notes.
    """
    notes: list[str] = []
    missing = int((~usable[: len(usable) - 1]).sum())
    if missing:
        notes.append(f"{missing} of {len(usable)} rows have no finite command or state; it is split there.")
    own = slot is None
    slot = clocks.interval if own else slot
    if clocks.paired:
        times = clocks.frames[: len(usable)]
        runs = _runs(times, usable, GAP * clocks.interval, notes, clocks.breaks)
        pieces = []
        for first, last in runs:
            extra = last < len(clocks.frames) and (last < len(usable) or not row_needed)
            extra = extra and 0 <= clocks.frames[last] - clocks.frames[last - 1] <= GAP * clocks.interval
            if last < len(usable):
                extra = extra and not (row_needed and not usable[last])
                extra = extra and not (clocks.breaks is not None and clocks.breaks[last - 1])
            frame = np.arange(first, last + extra)
            row = frame.clip(max=len(usable) - 1)
            pieces.append(_fit(clocks.frames[frame], clocks.frames[row], frame, row, slot, slot / 2 if own else None))
    else:
        order = np.argsort(clocks.rows, kind="stable")
        order = order[usable[order]]
        pieces = _unpaired(clocks, order, slot, notes)
    return [piece for piece in pieces if len(piece.frame)], notes


def _runs(
    times: np.ndarray, usable: np.ndarray, gap: float, notes: list[str], further: np.ndarray | None = None
) -> list[tuple[int, int]]:
    """Stretches [first, last) without a gap, a step back or a row that cannot be used."""
    steps = np.diff(times)
    gaps = steps[steps > gap]
    if len(gaps):
        lengths = ", ".join(f"{gap:.1f} s" for gap in gaps) if len(gaps) <= LISTED else f"up to {gaps.max():.1f} s"
        notes.append(f"{len(gaps)} gaps of {lengths} split it.")
    breaks = (steps > gap) | (steps < 0)
    if further is not None:
        more = further[: len(breaks)] & ~breaks
        if more.any():
            notes.append(f"the clock of the rows jumps {int(more.sum())} times where that of the pictures does not; it "
                         "is split there.")  # fmt: skip
        breaks |= further[: len(breaks)]
    bounds = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(times)]
    runs = []
    for first, last in pairwise(bounds):
        good = np.flatnonzero(usable[first:last]) + first
        if len(good):
            cuts = np.flatnonzero(np.diff(good) > 1) + 1
            runs += [(int(part[0]), int(part[-1]) + 1) for part in np.split(good, cuts)]
    return runs


def _fit(
    frame_times: np.ndarray, row_times: np.ndarray, frame: np.ndarray, row: np.ndarray, slot: float, even: float | None
) -> Piece:
    """A piece as it is where its pictures lie on the slots (``even``: within that many seconds), else resampled."""
    start = float(frame_times[0])
    off = np.abs(frame_times - start - slot * np.arange(len(frame_times)))
    if off.max() <= (even if even is not None else EPSILON * slot):
        return Piece(frame, row, start)
    at = start + slot * np.arange(int((frame_times[-1] - start) / slot + EPSILON) + 1)
    return Piece(frame[newest(frame_times, at, slot)], row[newest(row_times, at, slot)], start)


def _unpaired(clocks: Clocks, order: np.ndarray, slot: float, notes: list[str]) -> list[Piece]:
    rows = clocks.rows[order]
    row_step = typical_interval(rows) if len(rows) > 1 else None
    if row_step is None:
        return []
    frame_runs = _runs(clocks.frames, np.ones(len(clocks.frames), bool), GAP * clocks.interval, notes)
    row_notes: list[str] = []
    row_runs = _runs(rows, np.ones(len(rows), bool), max(GAP * row_step, PAUSE_S), row_notes)
    notes += [note.replace("gaps", "gaps between commands") for note in row_notes]
    pieces = []
    for first_frame, last_frame in frame_runs:
        frames = clocks.frames[first_frame:last_frame]
        for first_row, last_row in row_runs:
            part = rows[first_row:last_row]
            start = max(frames[0], part[0])
            end = min(frames[-1], part[-1] + row_step)
            if end < start:
                continue
            at = start + slot * np.arange(int((end - start) / slot + EPSILON) + 1)
            pieces.append(
                Piece(first_frame + newest(frames, at, slot), order[first_row + newest(part, at, slot)], float(start))
            )
    return pieces


def newest(times: np.ndarray, at: np.ndarray, slot: float) -> np.ndarray:
    """Index of the newest of ``times`` (rising) at every moment of ``at``, never a later one; the first before all."""
    return (np.searchsorted(times, at + EPSILON * slot, side="right") - 1).clip(min=0)
