"""``tsjepa trace``: radio links as tables; measured ones brought to it, simulated ones written, any of them drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from tsjepa.envs.links import links
from tsjepa.envs.settings import Radio
from tsjepa.radio.trace_import import import_trace
from tsjepa.radio.trace_picture import draw_trace
from tsjepa.radio.traces import describe, read_trace, write_trace
from tsjepa.support.checks import at_least

PICTURES = (".png", ".svg", ".pdf")


def trace(
    action: Literal["import", "simulate", "draw"],
    path: str,
    output: str | None = None,
    column: str | None = None,
    period_s: float | None = None,
    radio: Radio = Radio(),  # noqa: B008 - frozen
    num_devices: int = 10,
    slots: int = 500,
    slot_s: float = 0.02,
    seed: int = 0,
) -> dict:
    """Radio links: ``tsjepa trace import LOG TABLE.parquet``, ``simulate TABLE.csv``, ``draw TABLE PICTURE.png``.

    Args:
        action: "import" brings a log, or every log of a folder, to the table that a radio is driven by; "simulate"
            writes such a table of the channel that ``radio`` has; "draw" draws one, and says how an experiment of
            ``slots`` slots plays it: how often, how stretched, across which gaps.
        path: the log or its folder; the table to write; the table to draw.
        output: the Parquet file to write, with a picture (.png) and a report (.json) beside it; the picture. Nothing to
            give when a channel is simulated, whose picture lies beside its table.
        column: of an import, which of the log's columns is which, as "delay_ms=delay(ms), time_s=clock".
        period_s: of an import, seconds between rows, for logs without times; the step in which delivery opportunities
            are read.
        radio: of the channel that is simulated; of a drawing, its ``trace_stretch``.
        num_devices, seed: of the channel that is simulated.
        slots: how many are simulated, or played of what is drawn.
        slot_s: seconds per slot.

    Returns:
        Of an import the report, else what is said of the table.

    Raises:
        FileNotFoundError, ValueError: one sentence.
    """
    at_least(1, num_devices=num_devices, slots=slots)
    if not slot_s > 0:
        raise ValueError(f"slot_s {slot_s:g} must be a positive number of seconds.")
    if (output is None) != (action == "simulate"):
        needs = "a table alone" if action == "simulate" else "a file to read and one to write"
        raise ValueError(f"tsjepa trace {action} takes {needs}.")
    if action == "draw" and Path(str(output)).suffix not in PICTURES:
        raise ValueError(f"output is {output}; it is the name of a picture that ends in {', '.join(PICTURES)}.")
    if action == "import":
        return import_trace(path, output, column, period_s)
    if action == "simulate":
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_trace(path, links(radio, num_devices, slots, slot_s, seed))
    table = read_trace(path)
    said = describe(table, slot_s, radio.trace_stretch, slots if action == "draw" else None)
    draw_trace(output or Path(path).with_suffix(".png"), table, said)
    print(said)
    return {"describes": said}
