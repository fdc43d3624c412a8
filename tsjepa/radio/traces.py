"""Radio links as they were measured: tables of rows (time, device, what was measured), and their values in each slot.

The normal form is a Parquet (which needs pyarrow: ``pip install tsjepa[data]``) or CSV file with the columns

    time_s     seconds
    device     name or number; without the column there is one device
    snr_db, sinr_db, rsrp_dbm, delay_ms    measured values; an empty cell is no value
    lost       1 where the packet of that row was lost, 0 where not, or the share that was lost

of which all but ``time_s`` may be absent. ``tsjepa trace import`` brings other logs into this form.
"""

import csv
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tsjepa.support.files import whole
from tsjepa.support.foreign import optional
from tsjepa.support.tables import read_table

VALUES = ("snr_db", "sinr_db", "rsrp_dbm", "delay_ms", "lost")


class Trace(NamedTuple):
    """Rows of a trace, sorted by device and time.

    Attributes:
        time_s: [N] float64, from 0 at the first row of all.
        device: [N] int64, place in ``names``.
        names: of the devices.
        values: column -> [N] float64, not a number where the cell is empty.
    """

    time_s: Tensor
    device: Tensor
    names: tuple[str, ...]
    values: dict[str, Tensor]


class SlotTrace(NamedTuple):
    """A trace on a grid of slots.

    Attributes:
        values: column -> [devices, slots] float64, the last measured value, not a number before the first.
        rows: [devices, slots] int64, rows of the file that fall into the slot: 0 where the value is an older one.
    """

    values: dict[str, Tensor]
    rows: Tensor


def read_trace(path: str | Path) -> Trace:
    """Read a trace in the normal form; columns of other names are ignored.

    Raises:
        ValueError: naming the file and what is wrong with it: no time, no values, no rows, words in place of numbers.
    """
    path = Path(path)
    table = read_table(path)
    found = [name for name in VALUES if name in table]
    if "time_s" not in table or not found:
        raise ValueError(
            f"a trace needs time_s and one of {', '.join(VALUES)}; {path} has {', '.join(table)}: bring a log to such "
            f"a table with tsjepa trace import {path} TABLE.parquet"
        )
    if not len(table["time_s"]):
        raise ValueError(f"{path} has no rows")
    for name in ("time_s", *found):
        if table[name].ndim != 1 or table[name].dtype == object:
            raise ValueError(f"{path}: the column {name} does not hold a number in each row")
    time, *columns = (torch.from_numpy(np.array(table[name], dtype=np.float64)) for name in ("time_s", *found))
    if bool(time.isnan().any()):
        raise ValueError(f"{path}: row {int(time.isnan().nonzero()[0]) + 1} has no time")
    labels = [_label(cell) for cell in table["device"]] if "device" in table else ["0"] * len(time)
    names = tuple(dict.fromkeys(labels))
    place = {name: index for index, name in enumerate(names)}
    device = torch.tensor([place[label] for label in labels])
    order = torch.argsort(time, stable=True)
    order = order[torch.argsort(device[order], stable=True)]
    values = {name: column[order] for name, column in zip(found, columns, strict=True)}
    return Trace((time - time.min())[order], device[order], names, values)


def _label(cell: object) -> str:
    """A device's name; numbers that a column of mixed cells turned into floats are whole again."""
    return str(int(cell)) if isinstance(cell, float) and cell.is_integer() else str(cell)


def write_trace(path: str | Path, trace: Trace) -> None:
    """Write a trace in the normal form, CSV or (by its suffix) Parquet; the file appears when it is whole."""
    path = Path(path)
    table = {"time_s": trace.time_s.tolist(), "device": [trace.names[i] for i in trace.device.tolist()]}
    for name, column in trace.values.items():
        table[name] = [None if math.isnan(value) else value for value in column.tolist()]
    with whole(path) as partial:
        if path.suffix == ".parquet":
            optional("pyarrow.parquet").write_table(optional("pyarrow").table(table), partial)
        else:
            with partial.open("w", newline="") as file:
                writer = csv.writer(file)
                writer.writerow(table)
                writer.writerows(zip(*table.values(), strict=True))


def on_slots(trace: Trace, slot_s: float, stretch: float = 1.0) -> SlotTrace:
    """The trace on a grid of slots, each with the last value measured before its end; ``lost`` if any of its rows was.

    Args:
        trace: rows.
        slot_s: seconds per slot.
        stretch: factor on the time axis; 2 plays the trace at half its speed.

    Returns:
        As many slots as the trace lasts.
    """
    if not slot_s > 0 or not stretch > 0:
        raise ValueError(f"slot_s {slot_s:g} and stretch {stretch:g} must be positive")
    slot = (trace.time_s * stretch / slot_s + 1e-9).floor().to(torch.int64)
    count = int(slot.max()) + 1
    place = trace.device * count + slot
    size = (len(trace.names), count)
    rows = place.bincount(minlength=size[0] * size[1]).view(size)
    values = {}
    for name, column in trace.values.items():
        measured = ~column.isnan()
        last = torch.full((size[0] * size[1],), -1, dtype=torch.int64)
        last.scatter_reduce_(0, place[measured], measured.nonzero().flatten(), "amax")
        if name == "lost":
            any_lost = torch.zeros(size[0] * size[1], dtype=torch.float64)
            any_lost.scatter_reduce_(0, place[measured], column[measured], "amax")
            values[name] = any_lost.view(size).masked_fill(last.view(size) < 0, math.nan)
            continue
        held = last.view(size).cummax(-1).values
        values[name] = torch.where(held < 0, math.nan, column[held.clamp(min=0)])
    return SlotTrace(values, rows)


def describe(trace: Trace, slot_s: float, stretch: float = 1.0, slots: int | None = None, gap_s: float = 1.0) -> str:
    """One sentence: how long the trace is, its pace, how it is stretched and repeated, and where nothing was measured.

    Args:
        trace, slot_s, stretch: as of :func:`on_slots`.
        slots: slots that an experiment plays; None leaves the repetitions out.
        gap_s: pauses of the file that are longer than this are counted as gaps.
    """
    same = trace.device[1:] == trace.device[:-1]
    pauses = trace.time_s.diff()[same]
    lasts = trace.time_s.max().item()
    count = on_slots(trace, slot_s, stretch).rows.shape[1]
    parts = [
        f"{len(trace.names)} device{'s' * (len(trace.names) > 1)}, {len(trace.time_s)} rows over {lasts:.1f} s",
        f"a row every {1e3 * pauses.median():.0f} ms" if len(pauses) else "a single row each",
        f"{count} slots of {1e3 * slot_s:g} ms" + (f", its time stretched {stretch:g} times" if stretch != 1 else ""),
    ]
    if slots is not None:
        parts.append(f"played {slots / count:.1f} times" if slots > count else f"of which {slots} are played")
    gaps = pauses[pauses > gap_s]
    longest = ""
    if len(gaps):
        begins = trace.time_s[:-1][same][pauses.argmax()]
        longest = f", the longest of {gaps.max():.1f} s from {begins:.1f} s on, in which the last value is held"
    parts.append(f"{len(gaps) or 'no'} gap{'s' * (len(gaps) != 1)} of more than {gap_s:g} s{longest}")
    if "lost" in trace.values:
        parts.append(f"{100 * trace.values['lost'].nanmean():.1f} % of the packets lost")
    return "; ".join(parts) + "."
