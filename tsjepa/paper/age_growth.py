"""What the printed sign does to the age of information: ``python -m tsjepa.paper.age_growth``.

Schedulers alone, without a plant. The paper's score as printed serves the freshest devices first. Behind the SNR gate
(only devices above the threshold may transmit) the others get through when all fresh ones fade at once; without the
gate they never do, and the mean age grows by the share of forgotten devices in every slot.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from tsjepa.evaluation.fleet_pictures import age_growth_plot
from tsjepa.radio import SCHEDULERS, simulate_ages
from tsjepa.radio.link import DECODE_THRESHOLD_DB
from tsjepa.support.files import write_json
from tsjepa.support.provenance import provenance

CASES = (
    ("channel_aware", True),
    ("channel_aware", False),
    ("max_age", False),
    ("round_robin", False),
    ("channel_aware_literal", True),
    ("channel_aware_literal", False),
)
POINTS = 60  # of each curve, spaced evenly in the logarithm of time


def age_growth(
    output: str = "runs/age",
    num_devices: int = 10,
    resource_blocks: int = 2,
    mean_snr_db: float = 7.546445,
    snr_threshold_db: float = DECODE_THRESHOLD_DB,
    slots: int = 5_000,
    networks: int = 20,
    seed: int = 0,
) -> dict:
    """Writes age.json and age.png: mean age against time of the printed sign and of its rivals.

    Args:
        output: folder of the results.
        num_devices, resource_blocks: I and J.
        mean_snr_db: the default makes a link succeed with probability 0.573292, as in the reference numbers.
        snr_threshold_db: decode threshold.
        slots: length of the run.
        networks: independent repetitions, averaged.
        seed: of the fading, which is the same for every scheduler.
    """
    traces = []
    for name, snr_gate in CASES:
        scheduler = SCHEDULERS[name]
        if name.startswith("channel_aware"):
            scheduler = partial(scheduler, snr_gate=snr_gate)
        age = simulate_ages(
            scheduler,
            num_devices,
            resource_blocks,
            slots,
            mean_snr_db=mean_snr_db,
            snr_threshold_db=snr_threshold_db,
            batch=networks,
            seed=seed,
        ).mean_age
        traces.append({"scheduler": name, "snr_gate": snr_gate} | describe(age.mean(1).numpy()))
    result = {
        "made_by": provenance() | {"seeds": [seed]},
        "num_devices": num_devices,
        "resource_blocks": resource_blocks,
        "mean_snr_db": mean_snr_db,
        "snr_threshold_db": snr_threshold_db,
        "slots": slots,
        "networks": networks,
        "traces": traces,
    }
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "age.json", result, indent=1)
    age_growth_plot(result, folder / "age.png")
    for trace in traces:
        print(
            f"{trace['scheduler']:<24}{'gated' if trace['snr_gate'] else 'ungated':<9}mean age "
            f"{trace['time_average']:>9.2f}   growth per slot {trace['growth_per_slot']:>9.6f} "
            f"(R^2 {trace['r_squared']:.4f})"
        )
    return result


def describe(age: np.ndarray) -> dict:
    """Time average, straight-line fit, and a thinned curve of a mean age [K] that starts in slot 1.

    The curve's points are averages over the slots since the point before.
    """
    slots = np.arange(1, len(age) + 1)
    growth, offset = np.polyfit(slots, age, 1)
    residual = ((age - (growth * slots + offset)) ** 2).sum()
    edges = np.unique(np.geomspace(1, len(age) + 1, POINTS + 1).astype(int))
    pairs = list(pairwise(edges))
    return {
        "time_average": float(age.mean()),
        "growth_per_slot": float(growth),
        "r_squared": float(1 - residual / ((age - age.mean()) ** 2).sum()),
        "slot": [round(float((first + last - 1) / 2), 1) for first, last in pairs],
        "mean_age": [round(float(age[first - 1 : last - 1].mean()), 4) for first, last in pairs],
    }


if __name__ == "__main__":
    from jsonargparse import auto_cli

    auto_cli(age_growth)
