"""``tsjepa trace import``: measured links as one table, with their outages and a picture before they are used."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from tsjepa.radio.trace_formats import read_links
from tsjepa.radio.trace_log import Log
from tsjepa.radio.trace_tables import COLUMNS
from tsjepa.support.files import whole
from tsjepa.support.foreign import optional, reason

LISTED = 8
OUTAGE = 3  # periods: a shorter loss is an ordinary one


def import_trace(path: str, output: str, column: str | None = None, period_s: float | None = None) -> dict:
    """Brings a log, or every log of a folder, to the table that a radio is driven by.

    The table is Parquet with the columns ``time_s`` (since the log's first row), ``device`` (0, 1, ... in the order of
    the files), and of ``rsrp_dbm``, ``sinr_db``, ``delay_ms``, ``lost`` those that a log tells. ``lost`` is 1, 0, or
    the share that was lost where a log only tells that. A delay that is NaN where ``lost`` is 0 or absent was not
    logged. Beside it lie a picture (.png) and the report (.json).

    Args:
        path: file or folder.
        output: the Parquet file to write.
        column: which of the log's columns is which, as "delay_ms=delay(ms), time_s=clock".
        period_s: seconds between rows, for logs without times; the step in which delivery opportunities are read.

    Returns:
        The report: devices with kind, rows, received, lost, late, delays, outages, notes; and what was skipped.

    Raises:
        FileNotFoundError, ValueError: one sentence.
    """
    target = Path(output)
    if target.suffix != ".parquet":
        raise ValueError(f"output is {output}; it is the name of a file that ends in .parquet.")
    if period_s is not None and not 1e-6 <= period_s <= 3600:
        raise ValueError(f"period_s is {period_s}; it is a time in seconds, such as 0.02.")
    logs, skipped = read_logs(Path(path), parse_columns(column), period_s)
    report = {"devices": [describe(name, log) for name, log in logs.items()], "skipped": skipped}
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = {suffix: target.with_suffix(suffix) for suffix in (".png", ".json")}
    # all three are written before one of them replaces what was there
    with whole(target) as table, whole(beside[".png"]) as picture, whole(beside[".json"]) as told:
        write_table(table, list(logs.values()))
        draw(picture, logs)
        told.write_text(json.dumps(report, indent=2) + "\n")
    print(text(report))
    return report


def parse_columns(column: str | None) -> dict[str, str]:
    """``"delay_ms=delay(ms), time_s=clock"`` as a dict.

    Raises:
        ValueError: a part is no NAME=COLUMN, or the name is none of ours.
    """
    chosen = {}
    for part in column.split(",") if column else []:
        name, equals, own = part.partition("=")
        if not equals or name.strip() not in COLUMNS:
            raise ValueError(f"column is {column!r}; it is NAME=COLUMN with NAME one of {', '.join(COLUMNS)}.")
        chosen[name.strip()] = own.strip().strip("'\"")
    return chosen


def read_logs(path: Path, columns: dict[str, str], period_s: float | None) -> tuple[dict[str, Log], list[dict]]:
    """Logs by name, and the files of a folder that are none.

    Raises:
        FileNotFoundError, ValueError: there is none.
    """
    if not path.exists():
        raise FileNotFoundError(f"There is nothing at {path}.")
    if path.is_file():
        try:
            return _named(path.name, read_links(path, columns, period_s)), []
        except (KeyError, IndexError, TypeError, OverflowError) as error:
            raise ValueError(f"{path.name} cannot be read as a log of a radio link: {reason(error)}") from error
    logs: dict[str, Log] = {}
    skipped = []
    for file in sorted(file for file in path.rglob("*") if file.is_file() and not file.name.startswith(".")):
        name = file.relative_to(path).as_posix()
        try:
            logs |= _named(name, read_links(file, columns, period_s))
        except (ValueError, KeyError, IndexError, TypeError, OverflowError) as error:
            skipped.append({"name": name, "reason": reason(error)})
    if not logs:
        why = f": {skipped[0]['name']}: {skipped[0]['reason']}" if skipped else "."
        raise ValueError(f"{path} holds no log of a radio link that is known{why}")
    return logs, skipped


def _named(name: str, links: dict[str, Log]) -> dict[str, Log]:
    return {f"{name} {link}".rstrip(): log for link, log in links.items()}


def describe(name: str, log: Log) -> dict:
    """Counts, delays and outages of one log; lost, late and not logged are three things."""
    lost, delay = log.columns.get("lost"), log.columns.get("delay_ms")
    entry = {
        "name": name,
        "kind": log.kind,
        "rows": len(log.time_s),
        "duration_s": float(log.time_s[-1]),
        "period_s": log.period_s,
        "columns": list(log.columns),
        "outages": outages(log),
        "notes": log.notes,
    }
    if lost is not None:
        entry |= {"lost": float(np.nansum(lost)), "received": float(np.nansum(1 - lost))}
    if delay is not None:
        known = delay[np.isfinite(delay)]
        answered = np.isnan(delay) if lost is None else np.isnan(delay) & (lost == 0)
        entry |= {
            "late": int((known > 1000 * log.period_s).sum()),
            "not_logged": int(answered.sum()),
            "delay_ms": dict(zip(("least", "median", "p99", "most"), np.quantile(known, [0, 0.5, 0.99, 1]).tolist(),
                                 strict=True)) if len(known) else None,
        }  # fmt: skip
    for column in ("rsrp_dbm", "sinr_db"):
        if column in log.columns:
            known = log.columns[column][np.isfinite(log.columns[column])]
            entry[column] = [float(known.min()), float(known.max())] if len(known) else None
    return entry


def outages(log: Log) -> list[dict]:
    """Stretches in which nothing arrived, and in which nothing was logged, the longest first.

    Each has ``start_s``, ``duration_s`` (from the last row before to the first after) and ``kind``: "lost" or
    "not logged".
    """
    time, lost = log.time_s, log.columns.get("lost", np.zeros(len(log.time_s)))
    found = [(start, end, "lost") for start, end in _stretches(time, lost >= 1)]
    found += [(start, end, "not logged") for start, end in _stretches(time, np.isnan(lost))]
    for place in np.flatnonzero(np.diff(time) > OUTAGE * log.period_s):
        start, end = float(time[place]), float(time[place + 1])
        if not any(before <= start and end <= after for before, after, _ in found):
            found.append((start, end, "not logged"))
    listed = [{"start_s": start, "duration_s": end - start, "kind": kind} for start, end, kind in found]
    return sorted(listed, key=lambda outage: -outage["duration_s"])


def _stretches(time: np.ndarray, rows: np.ndarray) -> Iterator[tuple[float, float]]:
    """From the row before to the row after each run of at least OUTAGE ``rows`` (bool)."""
    for before, after in pairwise([-1, *np.flatnonzero(~rows), len(rows)]):
        if after - before > OUTAGE:
            yield float(time[max(before, 0)]), float(time[min(after, len(time) - 1)])


def write_table(path: Path, logs: list[Log]) -> None:
    """Writes the normal form of all logs as Parquet."""
    pa, parquet = optional("pyarrow"), optional("pyarrow.parquet")
    names = [name for name in COLUMNS if name != "time_s" and any(name in log.columns for log in logs)]
    columns = {
        "time_s": np.concatenate([log.time_s for log in logs]),
        "device": np.concatenate([np.full(len(log.time_s), device) for device, log in enumerate(logs)]),
    }
    for name in names:
        columns[name] = np.concatenate([log.columns.get(name, np.full(len(log.time_s), np.nan)) for log in logs])
    parquet.write_table(pa.table(columns), path)


def draw(path: Path, logs: dict[str, Log]) -> None:
    """Draws, as PNG, histograms of the delays and of the signal, and what was lost over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3), layout="constrained")
    delay_axis, signal_axis, loss_axis = figure.subplots(1, 3)
    for name, log in list(logs.items())[:LISTED]:
        if "delay_ms" in log.columns:
            delay = log.columns["delay_ms"]
            delay_axis.hist(
                delay[np.isfinite(delay)], bins=60, histtype="step", label=Path(name).stem[-24:].lstrip("_")
            )
        for column, style in (("rsrp_dbm", "solid"), ("sinr_db", "dashed")):
            if column in log.columns:
                values = log.columns[column]
                signal_axis.hist(values[np.isfinite(values)], bins=40, histtype="step", linestyle=style)
        if "lost" in log.columns:
            loss_axis.plot(log.time_s, np.nancumsum(log.columns["lost"]))
    delay_axis.set(xlabel="delay (ms)", ylabel="packets", yscale="log")
    signal_axis.set(xlabel="RSRP (dBm, solid), SINR (dB, dashed)", ylabel="rows")
    loss_axis.set(xlabel="time (s)", ylabel="packets lost so far")
    if delay_axis.has_data():
        delay_axis.legend(fontsize="x-small")
    figure.savefig(path, dpi=110, format="png")


def text(report: dict) -> str:
    """The report in words."""
    lines = []
    for device, entry in enumerate(report["devices"]):
        lines.append(
            f"device {device}: {entry['name']} ({entry['kind']}), {entry['rows']} rows in {entry['duration_s']:.1f} s, "
            f"one every {1000 * entry['period_s']:.4g} ms"
        )
        if "lost" in entry:
            lines.append(
                f"  received {entry['received']:g} of {entry['received'] + entry['lost']:g}, lost {entry['lost']:g}"
            )
        if entry.get("delay_ms"):
            delay = ", ".join(f"{name} {value:.1f}" for name, value in entry["delay_ms"].items())
            lines.append(f"  delay in ms: {delay}; late (more than a period): {entry['late']}, "
                         f"not logged: {entry['not_logged']}")  # fmt: skip
        for name, unit in (("rsrp_dbm", "dBm"), ("sinr_db", "dB")):
            if entry.get(name):
                lines.append(f"  {name}: {entry[name][0]:g} to {entry[name][1]:g} {unit}")
        for outage in entry["outages"][:LISTED]:
            lines.append(f"  outage   {outage['duration_s']:.1f} s from {outage['start_s']:.1f} s: {outage['kind']}")
        if len(entry["outages"]) > LISTED:
            lines.append(f"  ... and {len(entry['outages']) - LISTED} shorter outages")
        lines += [f"  note     {note}" for note in entry["notes"]]
    return "\n".join([*lines, *(f"skipped  {entry['name']}: {entry['reason']}" for entry in report["skipped"])])
