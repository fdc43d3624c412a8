"""Devices supported against target SNR (paper fig_scheduling)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from tsjepa.evaluation.metrics import interval
from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict, judge
from tsjepa.paper.devices import ACCEPTABLE, AT_LEAST, AT_MOST, EXACT, device_rows
from tsjepa.paper.grids import grid
from tsjepa.paper.store import flat

TITLE = "Devices supported against target SNR"
CAPTION = (
    "Largest fleet whose mean normalised score stays at 0.74, per 20 MHz. Updates take as many resource units (180 "
    "kHz for 1 ms) as their bits and channel need. The bandwidth is scaled so that the largest fleets have some 60 "
    "devices (0.25 MHz for embeddings, 1 MHz for WebP, 50 MHz for raw frames) and the result is scaled back; one "
    "search at 20 MHz checks that. TS-JEPA sends int8 embeddings and predicts between updates; the supervised "
    "controller gets WebP pictures of both frames, or raw frames as in the paper, and its command is held. Power "
    "control brings every device's mean SNR to the target, the decode threshold is 5 dB, fading is independent from "
    "slot to slot and known; process noise 0.008. Mean and 95 % interval over seeds, the same for all; ratios are "
    "geometric means over seeds. A seed whose own score does not cross 0.74 at the sizes tried has its number by "
    "extrapolation along the mean curve; the verdicts count them. A triangle points to where the number lies if the "
    "smallest fleet, of 4, was already too large, or the largest not yet."
)
MEASURES = ("devices",)
OURS, RAW, CODED, CHECK = "TS-JEPA", "supervised, raw frames", "supervised, WebP", "TS-JEPA, 20 MHz"
BEST, RIVALS = "channel_aware", ("round_robin", "opportunistic")
UNKNOWN = "unknown, about"
FAVOURED = 5.0  # times as many devices as the supervised controller with round-robin


def points(searches: list[dict], sizes: dict) -> list[dict]:
    """The sweep; fields of a search that are lists stand for all combinations.

    Args:
        searches: ``label`` and the fields of :func:`device_rows`.
        sizes: fields that all searches share unless they name them.
    """
    return [point for search in searches for point in grid(sizes | search)]


evaluate = device_rows


def draw(records: list[dict], path: str | Path) -> None:
    """A panel a controller: devices over the SNR, a line a scheduler."""
    draw_devices(records, path, "snr_target_db", "target SNR (dB)", "How many devices fit at which SNR?")


def draw_devices(records: list[dict], path: str | Path, over: str, name: str, question: str) -> None:
    """A panel a label: devices over a field of the points, a line a scheduler."""
    rows = [row for row in flat(records) if "devices" in row]
    labels = [label for label in plots.distinct(rows, "label") if label != CHECK] or [CHECK]
    labels.sort(key=lambda label: not label.startswith(OURS))
    schedulers = plots.distinct(rows, "scheduler")
    figure, axes = plots.canvas(columns=len(labels), width=3.6)
    for axis, label in zip(axes, labels, strict=True):
        for scheduler in schedulers:
            color = plots.color_of(scheduler)
            shown = plots.select(rows, label=label, scheduler=scheduler)
            groups = [(x, plots.select(shown, **{over: x})) for x in sorted(plots.distinct(shown, over))]
            if groups:
                plots.errorbar(axis, groups, "devices", color=color, label=scheduler)
                mark_bounds(axis, groups, color)
        check = plots.select(rows, label=CHECK)
        if check and label == OURS:
            groups = [(check[0][over], check)]
            plots.errorbar(axis, groups, "devices", color="black", markerfacecolor="white", label="not scaled")
            mark_bounds(axis, groups, "black")
        axis.set(xlabel=name, yscale="log")
        axis.set_title(label, fontsize=10)
        axis.grid(axis="y", which="both", alpha=0.2)
    low, high = min(axis.get_ylim()[0] for axis in axes), max(axis.get_ylim()[1] for axis in axes)
    for axis in axes:
        axis.set_ylim(low, high)
    axes[0].set_ylabel(f"devices in 20 MHz (at a score of {ACCEPTABLE})")
    plots.legend(figure, axes, "scheduler")
    plots.save(figure, path, question)


def mark_bounds(axis, groups: list[tuple[float, list[dict]]], color: str) -> None:
    """A triangle that points to where a number lies of which a search has only found a bound."""
    for x, seeds in groups:
        if seeds[0]["bound"] != EXACT:
            arrow = "^" if seeds[0]["bound"] == AT_LEAST else "v"
            axis.plot(x, plots.mean(seeds, "devices"), arrow, color=color, markersize=9)


@dataclass(frozen=True)
class Ratio:
    """How many times the devices: geometric mean over seeds, ends of its 95 % interval, and "at least" or the like.

    ``low`` is 0 where only an upper bound is known.
    """

    mean: float
    low: float
    high: float
    sign: str

    def times(self, name: str) -> str:
        """In words."""
        if self.sign:
            return f"{self.sign} {self.mean:.1f} times {name}"
        return f"{self.mean:.1f} ({self.low:.1f} to {self.high:.1f}) times {name}"


def ratio(ours: list[dict], theirs: list[dict]) -> Ratio:
    """Devices of ours over theirs; a search that ended at its smallest or largest size makes it a bound."""
    other = {row["seed"]: row["devices"] for row in theirs}
    logs = [math.log(row["devices"] / other[row["seed"]]) for row in ours if row["seed"] in other]
    centre, half = interval(logs)
    low = ours[0]["bound"] == AT_LEAST or theirs[0]["bound"] == AT_MOST
    high = ours[0]["bound"] == AT_MOST or theirs[0]["bound"] == AT_LEAST
    sign = UNKNOWN if low and high else AT_LEAST if low else AT_MOST if high else ""
    lower = 0.0 if high else math.exp(centre - half)
    return Ratio(math.exp(centre), lower, math.exp(centre + half), sign)


def counted(rows: list[dict]) -> str:
    """Devices with their interval and how many seeds are extrapolated, or the bound that is known."""
    bound = rows[0]["bound"]
    if bound != EXACT:
        return f"{bound} {plots.mean(rows, 'devices'):.0f}"
    beyond = sum(row["own_bound"] != EXACT for row in rows)
    return plots.text(rows, "devices", 0) + f" ({beyond} of {len(rows)} seeds extrapolated)" * bool(beyond)


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """Our scheduler against the others, ours against the supervised controller, at every SNR."""
    rows = [row for row in flat(records) if "devices" in row]

    def of(label: str, scheduler: str, snr: float) -> list[dict]:
        return plots.select(rows, label=label, scheduler=scheduler, snr_target_db=snr)

    snrs = [snr for snr in sorted(plots.distinct(rows, "snr_target_db")) if of(OURS, BEST, snr)]
    own = {
        (snr, rival): ratio(of(OURS, BEST, snr), of(OURS, rival, snr))
        for snr in snrs
        for rival in RIVALS
        if of(OURS, rival, snr)
    }
    if not own:
        return {}
    listed = "; ".join(
        f"{snr:g} dB: {counted(of(OURS, BEST, snr))} devices, "
        + ", ".join(own[snr, rival].times(rival) for rival in RIVALS if (snr, rival) in own)
        for snr in snrs
    )
    check = plots.select(rows, label=CHECK)
    if check:
        listed += f"; at {check[0]['snr_target_db']:g} dB and 20 MHz without scaling {counted(check)}"
    behind = not_ahead(own)
    found = {
        "devices_schedulers": judge(
            not behind,
            listed,
            behind,
            partly=any(times.low > 1 for times in own.values()),
        )
    }
    robin = {
        snr: ratio(of(OURS, "round_robin", snr), of(OURS, "opportunistic", snr))
        for snr in snrs
        if (snr, "opportunistic") in own and (snr, "round_robin") in own
    }
    if robin:
        others = [f"{snr:g} dB" for snr, times in robin.items() if times.low <= 1]
        found["opportunistic_last"] = judge(
            not others,
            "round-robin serves "
            + "; ".join(f"at {snr:g} dB {times.times('opportunistic')}" for snr, times in robin.items()),
            f"not clearly the fewest at {', '.join(others)}",
            partly=len(others) < len(robin),
        )
    return found | _resources(of, snrs) | _beside_supervised(of, snrs, own)


def not_ahead(own: dict[tuple, Ratio]) -> str:
    """The SNRs and rivals beside which our scheduler's lead lies within its interval, in words; empty if none."""
    return "; ".join(
        f"not clearly ahead of its own {rival} at {snr:g} dB" for (snr, rival), times in own.items() if times.low <= 1
    )


def _resources(of, snrs: list[float]) -> dict[str, Verdict]:
    if len(snrs) < 2:
        return {}
    low, high = snrs[0], snrs[-1]
    few, many = (plots.mean(of(OURS, BEST, snr), "devices") for snr in (low, high))
    return {
        "snr_resources": judge(
            many < few,
            f"{counted(of(OURS, BEST, low))} devices per 20 MHz at {low:g} dB, {counted(of(OURS, BEST, high))} at "
            f"{high:g} dB",
            f"a device takes {few / many:.2f} times the bandwidth at {high:g} dB",
        )
    }


def _beside_supervised(of, snrs: list[float], own: dict) -> dict[str, Verdict]:
    """Ours against the supervised controller, sent raw and coded frames, with round-robin and with our scheduler."""
    robin, same = (
        {
            (baseline, snr): ratio(of(OURS, BEST, snr), of(baseline, scheduler, snr))
            for baseline in (RAW, CODED)
            for snr in snrs
            if of(baseline, scheduler, snr)
        }
        for scheduler in ("round_robin", BEST)
    )
    if not robin or not same:
        return {}

    def listed(times: dict, scheduler: str) -> str:
        return "; ".join(f"{snr:g} dB: {value.times(f'{name}, {scheduler}')}" for (name, snr), value in times.items())

    above = [times.low > 1 for times in robin.values()]
    alike, alike_same = (
        "not clearly ahead of "
        + ", ".join(f"{name} at {snr:g} dB" for (name, snr), value in times.items() if value.low <= 1)
        for times in (robin, same)
    )
    short = [name for name, times in robin.items() if times.mean < FAVOURED or not times.low]
    behind = not_ahead(own)
    return {
        "scales": judge(all(above), listed(robin, "round-robin"), alike, any(above)),
        "goal_devices": judge(
            not short and not behind,
            f"{listed(robin, 'round-robin')}; "
            + "; ".join(f"{snr:g} dB: {times.times(f'its own {rival}')}" for (snr, rival), times in own.items()),
            "; ".join(
                [f"less than {FAVOURED:g} times {name} at {snr:g} dB" for name, snr in short] + [behind] * bool(behind)
            ),
            partly=all(above),
        ),
        "devices_controllers": judge(
            all(times.low > 1 for times in same.values()),
            listed(same, "channel-aware"),
            alike_same,
            partly=any(times.low > 1 for times in same.values()),
        ),
    }
