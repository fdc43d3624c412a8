"""What is said about a recording: notes, what was skipped and why, as values and as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tsjepa.data.import_plan import Part, Plan
from tsjepa.data.readers import Frames

LOSSY = ("yuv420p", "yuvj420p", "yuv422p", "yuvj422p")


def import_report(plan: Plan, taken: Sequence[Part], format_: str, splits: Mapping[str, Sequence]) -> dict:
    """All that an import says, as plain values; ``taken`` are the pieces that it has used."""
    notes = [*plan.notes, *coding_notes(taken[0].episode.frames), lag_note(plan)]
    if plan.still:
        notes.append(f"{plan.still} of {plan.pictures} pictures are the same as the one before.")
    return {
        "format": format_,
        "episodes": len({id(part.episode) for part in taken}),
        "trajectories": {name: len(trajectories) for name, trajectories in splits.items()},
        "slot_s": plan.slot,
        "offset_s": float(np.median(plan.offsets)),
        "lag_slots": plan.lag,
        "skipped": [asdict(entry) for entry in plan.skipped],
        "notes": notes,
    }


def coding_notes(frames: Frames) -> list[str]:
    """What the coding of the pictures costs, where it costs something."""
    if not frames.coding.endswith(LOSSY):
        return []
    return [
        f"The pictures are coded as {frames.coding}: chroma at a lower resolution and, in most settings, blurred "
        "edges; expect velocities to be read several times less precisely than from raw pictures."
    ]


def lag_note(plan: Plan) -> str:
    """How long the motion takes to follow the command."""
    if plan.lag is None:
        return "The lag from command to motion cannot be told from this recording."
    middle, low, high = plan.lag
    return f"The motion follows the command by about {middle} slots ({low} to {high})."


def import_table(report: dict, folder: Path) -> str:
    """The same as text."""
    counts = ", ".join(f"{count} {name}" for name, count in report["trajectories"].items())
    lines = [f"{folder}: {report['episodes']} episodes of {report['format']}, slots of {report['slot_s']:.6g} s, "
             f"trajectories: {counts}."]  # fmt: skip
    lines += [f"  note     {note}" for note in report["notes"]]
    lines += [f"  skipped  {entry['name']}: {entry['reason']}" for entry in report["skipped"]]
    return "\n".join(lines)
