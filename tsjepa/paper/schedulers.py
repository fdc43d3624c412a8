"""All schedulers: age, score and devices; late and statistical channel knowledge, correlated fading, bursts (ours)."""

from __future__ import annotations

from pathlib import Path

from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict, judge
from tsjepa.paper.devices import device_rows
from tsjepa.paper.devices_encoding import ratio
from tsjepa.paper.grids import grid
from tsjepa.paper.store import flat

TITLE = "Schedulers"
CAPTION = (
    "Ten resource blocks, each for one device and slot, mean SNR 10 dB, threshold 5 dB. The expert controls on the "
    "true state that it receives and holds its command between updates, so that no model's error hides the scheduler. "
    "Left: the largest fleet at a normalised score of 0.74; middle and right: score and mean age of 32 devices. "
    "Delayed knowledge is one slot old, statistical is the mean SNR; fading is independent from slot to slot, or "
    "correlated at 3 km/h (Jakes, 10.42 Hz: 0.61 from one slot to the next); bursts erase a fifth of the slots, five "
    "at a time, of which acknowledgements alone tell. channel_aware_literal has the sign that the paper prints. Mean "
    "and 95 % interval over seeds."
)
MEASURES = ("devices",)
PERFECT = "perfect"
OURS, RIVALS = "channel_aware", ("round_robin", "opportunistic", "max_age", "channel_aware_literal")


def points(cases: list[dict], sizes: dict) -> list[dict]:
    """The sweep; fields of a case that are lists stand for all combinations.

    Args:
        cases: ``case`` (its name), ``scheduler``, and what differs in the radio.
        sizes: the fields of :func:`device_rows` that all share.
    """
    return [point for case in cases for point in grid(sizes | case)]


evaluate = device_rows


def draw(records: list[dict], path: str | Path) -> None:
    """Devices, and score and age at a fixed size: a row a scheduler, a colour a case."""
    rows = flat(records)
    cases, schedulers = plots.distinct(rows, "case"), plots.distinct(rows, "scheduler")
    figure, axes = plots.canvas(columns=3, width=4.6, height=5.5)
    panels = (("devices", "devices (at a score of 0.74)"), ("score", plots.SCORE), ("mean_age", f"mean {plots.AGE}"))
    for axis, (measure, name) in zip(axes, panels, strict=True):
        for index, (color, case) in enumerate(zip(plots.PALETTE, cases, strict=False)):
            for place, scheduler in enumerate(schedulers):
                shown = [row for row in plots.select(rows, case=case, scheduler=scheduler) if measure in row]
                if measure != "devices":
                    shown = [row for row in shown if row["num_devices"] == row["also_at"]]
                if shown:
                    centre, half = plots.spread(shown, measure)
                    axis.errorbar(
                        centre,
                        place + 0.1 * (index - len(cases) / 2),
                        xerr=half,
                        color=color,
                        marker="o",
                        markersize=4,
                        capsize=2,
                        linestyle="",
                    )
        axis.set_yticks(range(len(schedulers)), schedulers if axis is axes[0] else [])
        title = "capacity" if measure == "devices" else f"{rows[0]['also_at']} devices"
        axis.set(xlabel=name, title=title)
        axis.invert_yaxis()
        axis.grid(axis="x", alpha=0.3)
    for color, case in zip(plots.PALETTE, cases, strict=False):
        axes[1].plot([], [], "o", color=color, label=case)
    plots.legend(figure, axes, "what is known of the channel", columns=6)
    plots.save(figure, path, "Which scheduler serves most, with what knowledge?")


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """Channel-aware against the schedulers that look at the channel alone, at the age alone, or at neither."""
    rows = flat(records)

    def of(case: str, scheduler: str, measure: str) -> list[dict]:
        shown = [row for row in plots.select(rows, case=case, scheduler=scheduler) if measure in row]
        return shown if measure == "devices" else [row for row in shown if row["num_devices"] == row["also_at"]]

    times = {
        (case, rival): ratio(of(case, OURS, "devices"), of(case, rival, "devices"))
        for case in plots.distinct(rows, "case")
        for rival in RIVALS
        if of(case, OURS, "devices") and of(case, rival, "devices")
    }
    if not times:
        return {}
    ages = ", ".join(
        f"{name} {plots.mean(of(PERFECT, name, 'mean_age'), 'mean_age'):.1f}"
        for name in (OURS, *RIVALS)
        if of(PERFECT, name, "mean_age")
    )
    behind = [f"{rival} ({case})" for (case, rival), value in times.items() if value.low <= 1]
    return {
        "scheduler_helps": judge(
            not behind,
            "devices: "
            + "; ".join(
                f"{case} {', '.join(value.times(rival) for (at, rival), value in times.items() if at == case)}"
                for case in dict.fromkeys(case for case, _ in times)
            )
            + f"; mean age in slots: {ages}",
            f"not clearly ahead of {', '.join(behind)}",
            partly=any(value.low > 1 for value in times.values()),
        )
    }
