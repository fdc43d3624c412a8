"""Plots of the fleet; each can be drawn anew from the JSON file that lies beside it (:func:`redraw`)."""

from __future__ import annotations

from pathlib import Path

from tsjepa.evaluation import style
from tsjepa.evaluation.metrics import interval
from tsjepa.evaluation.search import mean
from tsjepa.support.files import read_json

DASHED = ("oracle", "whittle", "max_weight")  # these can lie on top of another scheduler's line


def redraw(results: str | Path, picture: str | Path) -> None:
    """Draws the plot that belongs to a search.json, a fleet.json or an age.json from the file alone."""
    result = read_json(results)
    if "points" in result:
        capacity_plot(result, Path(picture))
    elif "traces" in result:
        age_growth_plot(result, Path(picture))
    elif "schedulers" in result:
        age_plot(result["schedulers"], Path(picture))
    else:
        raise ValueError(f"{results} is none of search.json, fleet.json and age.json.")


def capacity_plot(result: dict, path: Path) -> None:
    """Mean normalised score against the number of devices, one line a scheduler, 95 % intervals over seeds shaded."""
    curves: dict[str, dict[int, list[float]]] = {}
    for point in result["points"]:
        curve = curves.setdefault(point["scheduler"], {})
        curve.setdefault(point["num_devices"], []).append(point["normalized_score"])
    figure, (axis,) = style.canvas(width=7, height=5.2)
    order = [row["scheduler"] for row in result["largest"]]
    limits = {row["scheduler"]: row for row in result["largest"]}
    for name in order:
        curve = dict(sorted(curves[name].items()))
        sizes, means = list(curve), [mean(values) for values in curve.values()]
        halves = [interval(values)[1] for values in curve.values()]
        sign = {"at most": "≤", "at least": "≥", "exact": ""}[limits[name]["bound"]]
        axis.plot(
            sizes,
            means,
            color=style.color_of(name),
            label=f"{name} ({sign}{limits[name]['largest_num_devices']})",
            linestyle="--" if name in DASHED else "-",
            linewidth=1.6,
            marker="o",
            markersize=3,
        )
        low = [m - h for m, h in zip(means, halves, strict=True)]
        high = [m + h for m, h in zip(means, halves, strict=True)]
        axis.fill_between(sizes, low, high, color=style.color_of(name), alpha=0.15, linewidth=0)
    axis.axhline(result["acceptable_score"], color="black", linewidth=0.8, linestyle=":")
    axis.set(xlabel="fleet size I (devices)", ylabel=style.SCORE, ylim=(-0.03, 1.08))
    radio = result["settings"]["radio"]
    axis.set_title(
        f"controller: {result['settings']['controller']}, J = {radio['resource_blocks']}, "
        f"SNR target {radio['snr_target_db']} dB, threshold {radio['snr_threshold_db']} dB",
        fontsize=10,
    )
    style.legend(figure, [axis], "scheduler (largest I)", columns=3)
    style.save(figure, path, f"How many devices keep a score of {result['acceptable_score']}?")


def device_plot(rows: list[dict], path: Path) -> None:
    """Raw score of every device, sorted, one line a scheduler, beside that of perfect feedback."""
    figure, (axis,) = style.canvas(width=6, height=4.2)
    names = list(dict.fromkeys(row["scheduler"] for row in rows))
    perfect = sorted((row["perfect_feedback"] for row in rows if row["scheduler"] == names[0]), reverse=True)
    share = [100 * (index + 0.5) / len(perfect) for index in range(len(perfect))]
    axis.plot(share, perfect, color="black", linewidth=1, linestyle=":", label="perfect feedback")
    for name in names:
        scores = sorted((row["raw_score"] for row in rows if row["scheduler"] == name), reverse=True)
        axis.plot(share, scores, color=style.color_of(name), linewidth=1.5, label=name)
    axis.set(xlabel="devices, best first (%)", ylabel="raw score (0 to 1)", ylim=(0, None), xlim=(0, 100))
    style.legend(figure, [axis], columns=3)
    style.save(figure, path, "Does every device get its share?")


def age_plot(rows: list[dict], path: Path) -> None:
    """Share of device-slots whose age of information exceeds each value."""
    figure, (axis,) = style.canvas(width=6, height=4.2)
    for row in rows:
        total = sum(row["age_counts"])
        older, exceeding = total, []
        for count in row["age_counts"]:
            exceeding.append(older / total)
            older -= count
        axis.step(
            range(1, len(exceeding) + 1),
            exceeding,
            where="mid",
            color=style.color_of(row["scheduler"]),
            label=f"{row['scheduler']} (mean {row['mean_age']:.1f})",
        )
    axis.set(xlabel=style.AGE, ylabel="share of device-slots of at least this age (0 to 1)", yscale="log", xscale="log")
    style.legend(figure, [axis], columns=2)
    style.save(figure, path, "How old does information get?")


def age_growth_plot(result: dict, path: Path) -> None:
    """Mean age of information against time, one line a scheduler and gate."""
    figure, (axis,) = style.canvas(width=6.4, height=4.4)
    for trace in result["traces"]:
        axis.plot(
            trace["slot"],
            trace["mean_age"],
            color=style.color_of(trace["scheduler"]),
            linestyle="-" if trace["snr_gate"] else "--",
            label=f"{trace['scheduler']}, {'with' if trace['snr_gate'] else 'without'} SNR gate",
        )
    axis.set(xlabel="time (slots)", ylabel=f"mean {style.AGE}", xscale="log", yscale="log")
    axis.set_title(
        f"I = {result['num_devices']}, J = {result['resource_blocks']}, mean SNR {result['mean_snr_db']} dB, "
        f"threshold {result['snr_threshold_db']} dB",
        fontsize=10,
    )
    style.legend(figure, [axis], columns=2)
    style.save(figure, path, "Does anybody starve?")
