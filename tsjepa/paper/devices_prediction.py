"""Devices supported against packet loss (paper fig_scheduling_pred)."""

from __future__ import annotations

from pathlib import Path

from tsjepa.paper import devices_encoding, plots
from tsjepa.paper.claims import Verdict, judge
from tsjepa.paper.devices_encoding import BEST, OURS, RIVALS, ratio
from tsjepa.paper.store import flat

TITLE = "Devices supported against packet loss"
CAPTION = (
    "As the figure before, at a mean SNR of 20 dB and half the scaled bandwidths, with packets erased independently "
    "besides, which no scheduler foresees but as a probability. Prediction is what "
    "TS-JEPA adds to its smaller packets: the panel in the middle is the same model with its command held between "
    "updates."
)
MEASURES = ("devices",)
SUPERVISED = devices_encoding.CODED
HELD = "TS-JEPA, command held"
SUBSTANTIAL = 1.5  # times the devices
KEPT, KEPT_MORE = 0.75, 0.1  # share of the devices that has to be left, and more of it than the supervised one's
points = devices_encoding.points
evaluate = devices_encoding.evaluate


def draw(records: list[dict], path: str | Path) -> None:
    """A panel a controller: devices over the loss, a line a scheduler."""
    devices_encoding.draw_devices(
        records, path, "loss", "packets erased (share)", "How many devices fit when packets are lost?"
    )


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """Ours against the supervised controller under its schedulers, and what loss costs each."""
    rows = [row for row in flat(records) if "devices" in row]

    def of(label: str, scheduler: str, loss: float) -> list[dict]:
        return plots.select(rows, label=label, scheduler=scheduler, loss=loss)

    losses = [loss for loss in sorted(plots.distinct(rows, "loss")) if of(OURS, BEST, loss)]
    times = {
        (loss, rival): ratio(of(OURS, BEST, loss), of(SUPERVISED, rival, loss))
        for loss in losses
        for rival in RIVALS
        if of(SUPERVISED, rival, loss)
    }
    if not times:
        return {}
    short = [f"supervised, {rival}, at {loss:g}" for (loss, rival), value in times.items() if value.low <= SUBSTANTIAL]
    found = {
        "devices_loss": judge(
            not short,
            "; ".join(
                f"loss {loss:g}: {value.times(f'supervised, {rival}')}" for (loss, rival), value in times.items()
            ),
            f"not clearly {SUBSTANTIAL} times {'; '.join(short)}",
            partly=all(value.low > 1 for value in times.values()),
        )
    }
    kept = {
        label: (plots.mean(of(label, BEST, losses[-1]), "devices"), plots.mean(of(label, BEST, losses[0]), "devices"))
        for label in (OURS, HELD, SUPERVISED)
        if of(label, BEST, losses[0]) and of(label, BEST, losses[-1])
    }
    if OURS in kept and SUPERVISED in kept and len(losses) > 1:
        share = {label: after / before for label, (after, before) in kept.items()}
        found["supervised_loss"] = judge(
            share[OURS] > share[SUPERVISED] + KEPT_MORE and share[OURS] >= KEPT,
            ", ".join(
                f"{label} keeps {value:.0%} of its devices at a loss of {losses[-1]:g}"
                for label, value in share.items()
            ),
            f"{OURS} keeps "
            + " and ".join(
                [f"less than {KEPT:.0%}"] * (share[OURS] < KEPT)
                + [f"no more than {KEPT_MORE:.0%} above {SUPERVISED}"] * (share[OURS] <= share[SUPERVISED] + KEPT_MORE)
            ),
            partly=share[OURS] > share[SUPERVISED],
        )
    return found
