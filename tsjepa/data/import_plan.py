"""What an import will take from a recording: its episodes on one clock, cut at gaps, and what is left out and why."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tsjepa.data.clock import Clocks, Piece, cut, match_clocks, typical_interval
from tsjepa.data.lag import Lag, command_lag, common_lag
from tsjepa.data.readers import Episode, Recording, Skipped
from tsjepa.data.readers.episode import all_of
from tsjepa.support.foreign import reason
from tsjepa.support.spec import UNKNOWN

SAME_RATE = 0.05  # relative difference of two episodes' intervals that is still one rate
FINEST_LAG = 4  # parts of a slot that a lag is looked for in: rows that come faster are thinned
CLAIMED_RATE = 0.01  # a measured interval this near to the claimed one is taken for it


@dataclass
class Part:
    """A piece of an episode, named, with the pictures and rows that fill its slots."""

    name: str
    episode: Episode
    piece: Piece
    action: np.ndarray
    state: np.ndarray | None


@dataclass
class Plan:
    """Everything but the pictures.

    Attributes:
        parts: pieces in the order of the recording.
        slot: seconds.
        action_names, action_units, state_names, state_units: columns of every part.
        skipped: what cannot be used.
        notes: what is odd, one sentence each.
        lag: slots from command to motion (median, 10 %, 90 % over columns or episodes), or None where nobody can tell.
        offsets: seconds by which the rows' clock was ahead, one an episode.
        still, pictures: how many pictures are the same as the one before, of how many; counted when they are read.
    """

    parts: list[Part]
    slot: float
    action_names: list[str]
    action_units: list[str]
    state_names: list[str]
    state_units: list[str]
    skipped: list[Skipped] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    lag: Lag | None = None
    offsets: list[float] = field(default_factory=list)
    still: int = 0
    pictures: int = 0


def plan_import(recording: Recording, slot: float | None = None, offset: float | None = None) -> Plan:
    """Reads all rows and stamps, and no picture but the first of every episode.

    Args:
        recording: what :func:`tsjepa.data.readers.open_recording` gives.
        slot: seconds to resample to, or None for the recording's own interval.
        offset: seconds that the rows' clock is ahead, or None to find it.

    Raises:
        ValueError: nothing of it can be used; the sentence says why.
    """
    skipped, notes, ready = [], [], []
    for item in all_of(recording):
        if isinstance(item, Skipped):
            skipped.append(item)
            continue
        try:
            episode = _without_dead_state(item)
            if ready:
                _same_columns(ready[0][0], episode)
            clocks = match_clocks(
                episode.times,
                episode.frames.times,
                len(episode.action),
                episode.frames.count,
                episode.paired,
                recording.rate_hz,
                offset,
            )
        except ValueError as error:
            skipped.append(Skipped(item.name, reason(error)))
            continue
        ready.append((episode, clocks))
    if not ready:
        raise ValueError(_nothing(skipped))
    intervals = np.array([clocks.interval for _, clocks in ready])
    notes += _rate_notes(recording, ready, intervals)
    own, slot = slot is None, slot or _own_slot(recording, intervals)
    parts, lags = [], []
    for episode, clocks in ready:
        usable = np.isfinite(episode.action).all(axis=1)
        if episode.state is not None:
            usable &= np.isfinite(episode.state).all(axis=1)
        even = own and abs(clocks.interval / slot - 1) < SAME_RATE
        if even:
            clocks.interval = slot
        pieces, cut_notes = cut(clocks, usable, None if even else slot, episode.state is not None)
        if not pieces:
            skipped.append(Skipped(episode.name, "no row of it has a finite command at a time that has a picture."))
        for number, piece in enumerate(pieces):
            name = episode.name if len(pieces) == 1 else f"{episode.name} piece {number}"
            state = None if episode.state is None else episode.state[piece.row]
            parts.append(Part(name, episode, piece, episode.action[piece.row], state))
        lags.append(_lag(episode, clocks, slot))
        notes += [f"{episode.name}: {note}" for note in [*episode.notes, *clocks.notes, *cut_notes]]
    if not parts:
        raise ValueError(_nothing(skipped))
    if max(len(part.piece.frame) for part in parts) < 2:
        raise ValueError(
            "No two pictures of the recording follow each other by their times, so nothing can be imported; if the "
            "times of its rows are milliseconds, call their column time_ms, or pass --time 'NAME(ms)'."
        )
    first = ready[0][0]
    plan = Plan(
        parts, slot, first.action_names, first.action_units, first.state_names, first.state_units, skipped,
        merge_notes([*recording.notes, *notes]),
        common_lag(lags, [len(episode.action) for episode, _ in ready]),
        [clocks.offset for _, clocks in ready],
    )  # fmt: skip
    plan.notes += _constant_columns(plan)
    return plan


def _nothing(skipped: list[Skipped]) -> str:
    if not skipped:
        return "The recording holds no episode."
    rest = f" ({len(skipped)} entries in all)" if len(skipped) > 1 else ""
    return f"Nothing of the recording can be used: {skipped[0].name}: {skipped[0].reason}{rest}"


def _own_slot(recording: Recording, intervals: np.ndarray) -> float:
    interval = float(np.median(intervals))
    if recording.rate_hz and abs(interval * recording.rate_hz - 1) < CLAIMED_RATE:
        return 1 / recording.rate_hz
    return round(interval, 6)


def _rate_notes(recording: Recording, ready: list, intervals: np.ndarray) -> list[str]:
    notes, typical = [], float(np.median(intervals))
    claimed = recording.rate_hz
    if claimed and abs(typical * claimed - 1) > CLAIMED_RATE:
        notes.append(f"{claimed:g} pictures a second are claimed; {1 / typical:.4g} are measured.")
    other = [episode.name for (episode, _), interval in zip(ready, intervals, strict=True)
             if abs(interval / typical - 1) > SAME_RATE]  # fmt: skip
    if other:
        notes.append(
            f"The frame rates are mixed, {1 / intervals.max():.4g} to {1 / intervals.min():.4g} a second: {len(other)} "
            f"of {len(ready)} episodes ({', '.join(other[:4])}) are resampled."
        )
    return notes


def _same_columns(first: Episode, other: Episode) -> None:
    """Puts the columns of ``other`` in the order of the first episode's.

    Raises:
        ValueError: it has others.
    """
    for kind in ("action", "state"):
        wanted, given = getattr(first, f"{kind}_names"), getattr(other, f"{kind}_names")
        if wanted == given:
            continue
        if sorted(wanted) != sorted(given):
            raise ValueError(f"its {kind} has the columns {_few(given)}; the first episode has {_few(wanted)}.")
        order = [given.index(name) for name in wanted]
        setattr(other, kind, getattr(other, kind)[:, order])
        setattr(other, f"{kind}_names", list(wanted))
        setattr(other, f"{kind}_units", [getattr(other, f"{kind}_units")[place] for place in order])
        other.notes.append(f"the columns of its {kind} stand in another order than in the first episode.")


def _few(names: list[str]) -> str:
    return ", ".join(names[:6]) + (f", ... ({len(names)})" if len(names) > 6 else "") if names else "none"


def _without_dead_state(episode: Episode) -> Episode:
    """Drops a state that is never finite, instead of every row."""
    if episode.state is not None and not np.isfinite(episode.state).all(axis=1).any():
        episode.notes.append("its state is never finite and is left out.")
        episode.state, episode.state_names, episode.state_units = None, [], []
    return episode


def _lag(episode: Episode, clocks: Clocks, slot: float) -> Lag | None:
    """Slots by which the state follows the command, and their range; None where it cannot be told."""
    if episode.state is None:
        return None
    interval = typical_interval(clocks.rows) or slot
    every = max(1, round(slot / interval / FINEST_LAG))
    rows = np.isfinite(episode.action).all(axis=1) & np.isfinite(episode.state).all(axis=1)
    rows = np.flatnonzero(rows)[::every]
    same = episode.state_names == episode.action_names or (
        episode.state.shape == episode.action.shape and UNKNOWN in episode.action_units
    )
    lag = command_lag(episode.action[rows], episode.state[rows], every * interval, same)
    if lag is None:
        return None
    middle, low, high = (round(steps * every * interval / slot) for steps in lag)
    return middle, low, high


def _constant_columns(plan: Plan) -> list[str]:
    notes = []
    for kind, names in (("action", plan.action_names), ("state", plan.state_names)):
        values = [getattr(part, kind) for part in plan.parts if getattr(part, kind) is not None]
        if not values:
            continue
        spread = np.max([np.nanmax(part, axis=0) for part in values], axis=0) - np.min(
            [np.nanmin(part, axis=0) for part in values], axis=0
        )
        still = [name for name, range_ in zip(names, spread, strict=True) if range_ == 0]
        if still:
            notes.append(f"{len(still)} of {len(names)} columns of the {kind} are constant ({_few(still)}).")
    return notes


def merge_notes(notes: list[str]) -> list[str]:
    """The same sentence about several episodes as one."""
    merged: dict[str, list[str]] = {}
    for note in notes:
        name, colon, text = note.partition(": ")
        merged.setdefault(text if colon else note, []).append(name if colon else "")
    sentences = []
    for text, names in merged.items():
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        sentences.append(text if names == [""] else f"{', '.join(names[:3])}{more}: {text}")
    return sentences
