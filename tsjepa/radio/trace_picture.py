"""A picture of a trace: what was measured over time, and where nothing was."""

from __future__ import annotations

from pathlib import Path

import torch

from tsjepa.radio.traces import Trace
from tsjepa.support.files import whole

LISTED = 8  # devices with a line of their own
LABELS = {
    "snr_db": "SNR (dB)",
    "sinr_db": "SINR (dB)",
    "rsrp_dbm": "RSRP (dBm)",
    "delay_ms": "delay (ms)",
    "lost": "packets lost so far",
}


def draw_trace(path: str | Path, trace: Trace, title: str = "", gap_s: float = 1.0) -> None:
    """One panel for each column that the trace has, of its first devices; gaps of more than ``gap_s`` are grey."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 1 + 2 * len(trace.values)), layout="constrained")
    panels = figure.subplots(len(trace.values), squeeze=False, sharex=True)[:, 0]
    for device, name in enumerate(trace.names[:LISTED]):
        rows = trace.device == device
        time = trace.time_s[rows]
        for panel, (column, values) in zip(panels, trace.values.items(), strict=True):
            own = values[rows]
            known = ~own.isnan()
            drawn = own[known].cumsum(0) if column == "lost" else own[known]
            panel.plot(time[known], drawn, label=name, linewidth=0.8, drawstyle="steps-post")
            panel.set_ylabel(LABELS[column])
        for begins, ends in gaps(time, gap_s):
            for panel in panels:
                panel.axvspan(begins, ends, color="0.85", zorder=0)
    panels[-1].set_xlabel("time (s)")
    panels[0].legend(title="device", fontsize="x-small", ncols=LISTED, loc="upper right")
    figure.suptitle(title, fontsize="small", wrap=True)
    with whole(path, Path(path).suffix) as partial:
        figure.savefig(partial, dpi=110)


def gaps(time: torch.Tensor, gap_s: float) -> list[tuple[float, float]]:
    """Where the rows of one device, sorted in time [N], are more than ``gap_s`` apart: the row before, and after."""
    apart = time.diff() > gap_s
    return list(zip(time[:-1][apart].tolist(), time[1:][apart].tolist(), strict=True))
