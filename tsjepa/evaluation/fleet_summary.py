"""The figures of a fleet: a row a scheduler, a row a device, and the table as text."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from tsjepa.evaluation.metrics import Run, interval, normalized_score


def summary(scheduler: str, runs: list[Run], optimal: Tensor) -> dict:
    """One row of the table: a scheduler over all seeds. ``age_counts[h - 1]`` counts the device-slots of age h."""
    scores = [normalized_score(outcome.raw_score(), best) for outcome, best in zip(runs, optimal, strict=True)]
    mean, half = interval(scores)
    ages = torch.stack([outcome.age for outcome in runs])
    energy = {}
    if runs[0].energy_j is not None:
        energy["joules_per_device_and_slot"] = _mean(runs, lambda outcome: outcome.energy_j)
        arrived = sum(int(outcome.delivered.sum()) for outcome in runs)
        spent = sum(float(outcome.energy_j.double().sum()) for outcome in runs)
        energy["joules_per_update"] = spent / arrived if arrived else None
    return {
        "scheduler": scheduler,
        "normalized_score": mean,
        "interval_95": half,
        "per_seed": scores,
        "failed_share": _mean(runs, Run.failed),
        "mean_age": float(ages.double().mean()),
        "age_95_percentile": float(np.quantile(ages.numpy(), 0.95)),  # torch's takes no more than 2**24 numbers
        "delivery_rate": sum(outcome.delivery_rate() for outcome in runs) / len(runs),
        "utilisation": sum(outcome.utilisation() for outcome in runs) / len(runs),
        **bits_sent(runs),
        **energy,
        "age_counts": torch.bincount(ages.flatten() - 1).tolist(),
    }


def bits_sent(runs: list[Run]) -> dict[str, float]:
    """Bits of updates per device and slot, arrived or not, and where devices say how urgent they are, of that too."""
    bits = {"bits_per_device_and_slot": _mean(runs, lambda outcome: outcome.payload_bits)}
    if runs[0].signalling_bits is not None:
        bits["signalling_bits_per_device_and_slot"] = _mean(runs, lambda outcome: outcome.signalling_bits)
    return bits


def device_rows(scheduler: str, runs: list[Run], optimal: Tensor) -> list[dict]:
    """One row per device and seed."""
    rows = []
    for seed, (outcome, best) in enumerate(zip(runs, optimal.tolist(), strict=True)):
        columns = {
            "raw_score": outcome.raw_score(),
            "failed": outcome.failed().long(),
            "mean_age": outcome.age.double().mean(0),
            "transmissions": outcome.scheduled.sum(0),
            "deliveries": outcome.delivered.sum(0),
            "bits": outcome.payload_bits.sum(0),
        }
        if outcome.energy_j is not None:
            columns["joules"] = outcome.energy_j.double().sum(0)
        lists = {name: [round(value, 6) for value in column.tolist()] for name, column in columns.items()}
        for device, perfect in enumerate(best):
            of_device = {"scheduler": scheduler, "seed": seed, "device": device, "perfect_feedback": round(perfect, 6)}
            rows.append(of_device | {name: values[device] for name, values in lists.items()})
    return rows


def table(rows: list[dict]) -> str:
    """The rows as aligned text."""
    spent = "joules_per_update" in rows[0]
    width = max(24, *(len(row["scheduler"]) + 1 for row in rows))
    lines = [
        f"{'scheduler':<{width}}{'score':>15}{'failed':>9}{'age':>7}{'age 95 %':>10}{'delivered':>11}{'used':>7}"
        f"{'bit/device/slot':>17}" + f"{'mJ/update':>12}" * spent
    ]
    for row in rows:
        lines.append(
            f"{row['scheduler']:<{width}}{row['normalized_score']:>7.3f} ± {row['interval_95']:.3f}"
            f"{row['failed_share']:>9.1%}{row['mean_age']:>7.2f}{row['age_95_percentile']:>10.0f}{row['delivery_rate']:>11.1%}"
            f"{row['utilisation']:>7.0%}{row['bits_per_device_and_slot']:>17.1f}"
            + (_millijoules(row["joules_per_update"]) if spent else "")
        )
    return "\n".join(lines)


def _millijoules(joules: float | None) -> str:
    return f"{'none':>12}" if joules is None else f"{1e3 * joules:>12.3g}"


def _mean(runs: list[Run], values: Callable[[Run], Tensor]) -> float:
    return float(torch.stack([values(outcome).double() for outcome in runs]).mean())


def as_csv(rows: list[dict]) -> str:
    """The rows as text, their keys in the first line."""
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
