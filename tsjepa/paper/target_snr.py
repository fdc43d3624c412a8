"""Target SNR, one device: packets lost while the training data are gathered, and in the loop (paper fig_SNR_impact)."""

from __future__ import annotations

from pathlib import Path

from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict, judge
from tsjepa.paper.store import flat
from tsjepa.paper.training import trained_rows
from tsjepa.radio import outage_probability
from tsjepa.radio.link import db_to_linear

TITLE = "Target SNR"
CAPTION = (
    "At a decode threshold of 5 dB, mean SNRs of 5, 10 and 20 dB lose 63, 27 and 3 % of the packets. Thinned: TS-JEPA "
    "and its actor trained on the share of the trajectories that arrives (66, 131 and 174 of 180; a loss frame by "
    "frame would leave hardly any window of frames whole at 5 dB), with a fraction of the shipped recipes' steps, the "
    "same for every point, one training seed, on a CPU. In the loop: the same share of the updates is lost, one sent "
    "in every slot, and TS-JEPA predicts where one is. All data: trained on all 180."
)
MEASURES = ("score", "nmae")
WORSE, A_LITTLE_WORSE = 1.2, 1.05  # times the command error at the highest SNR
LOWER = 0.05  # normalised score
LOSSLESS, LOSSY = "no update lost", "updates lost"
CASES = (("thinned", LOSSLESS), ("thinned", LOSSY), ("all data", LOSSY))


def points(
    snr_target_db: list[float],
    snr_threshold_db: float,
    train_episodes: int,
    actor_episodes: int,
    training_seeds: list[int],
    budget: dict,
    sizes: dict,
) -> list[dict]:
    """The sweep: for every SNR the data that arrive, and all of them.

    Args:
        snr_target_db, snr_threshold_db: mean SNR and decode threshold.
        train_episodes, actor_episodes: trajectories that are sent.
        training_seeds: of the weights and batches.
        budget: see :func:`trained_rows`.
        sizes: ``seeds``, ``starts``, ``slots``, ``process_noise_std``.
    """
    share = {snr: 1 - outage(snr, snr_threshold_db) for snr in snr_target_db}
    thinned = [
        {
            "data": "thinned",
            "train_episodes": round(arriving * train_episodes),
            "actor_episodes": round(arriving * actor_episodes),
            "loop_snr_db": [snr],
        }
        for snr, arriving in share.items()
    ]
    whole = {"data": "all data", "train_episodes": train_episodes, "actor_episodes": actor_episodes}
    common = {"snr_threshold_db": snr_threshold_db} | budget | sizes
    return [
        data | {"training_seed": seed} | common
        for seed in training_seeds
        for data in (*thinned, whole | {"loop_snr_db": list(snr_target_db)})
    ]


def outage(snr_db: float, threshold_db: float) -> float:
    """Share of the packets that Rayleigh fading loses."""
    return float(outage_probability(db_to_linear(threshold_db), db_to_linear(snr_db)))


def evaluate(point: dict) -> list[dict]:
    """Trains, then closes the loop with the losses of each SNR, and without any."""
    loops = [
        {"update_every": 1, "snr_target_db": snr, "loss": loss}
        for snr in point["loop_snr_db"]
        for loss in (0.0, outage(snr, point["snr_threshold_db"]))
    ]
    return trained_rows(point, loops if point["data"] == "thinned" else [loop for loop in loops if loop["loss"]])


def cases(records: list[dict]) -> dict[tuple, list[dict]]:
    """Rows by data and loop."""
    rows = flat(records)
    return {
        (data, loop): [row for row in plots.select(rows, data=data) if (row["loss"] > 0) == (loop == LOSSY)]
        for data, loop in CASES
    }


def draw(records: list[dict], path: str | Path) -> None:
    """Command error and score over the target SNR."""
    figure, axes = plots.canvas(columns=2)
    for color, ((data, loop), rows) in zip(plots.PALETTE, cases(records).items(), strict=False):
        snrs = sorted(plots.distinct(rows, "snr_target_db"))
        groups = [(snr, plots.select(rows, snr_target_db=snr)) for snr in snrs]
        if groups:
            plots.errorbar(axes[1], groups, "score", color=color, label=f"{data} in training, {loop}")
        if groups and loop == LOSSLESS:
            plots.errorbar(axes[0], groups, "nmae", color=color, label="thinned in training")
    axes[0].set(xlabel="target SNR (dB)", ylabel=plots.NMAE, title="command error")
    axes[1].set(xlabel="target SNR (dB)", ylabel=plots.SCORE, title="score, update sent in every slot")
    plots.legend(figure, axes, columns=2)
    plots.save(figure, path, "Does a poor link spoil training or control?")


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """5 against 20 dB."""
    found = cases(records)
    thinned, lossy = found["thinned", LOSSLESS], found["thinned", LOSSY]
    snrs = sorted(plots.distinct(thinned, "snr_target_db"))
    if len(snrs) < 2:
        return {}
    low, high = snrs[0], snrs[-1]
    errors = {snr: plots.select(thinned, snr_target_db=snr) for snr in snrs}
    worse = plots.mean(errors[low], "nmae") / plots.mean(errors[high], "nmae")
    scores = {
        name: {snr: plots.mean(plots.select(rows, snr_target_db=snr), "score") for snr in (low, high)}
        for name, rows in (("losses in training alone", thinned), ("in the loop too", lossy))
    }
    fall = {name: values[high] - values[low] for name, values in scores.items()}
    return {
        "snr_nmae": judge(
            worse > WORSE,
            "command NMAE " + ", ".join(f"{plots.text(rows, 'nmae', 4)} at {snr:g} dB" for snr, rows in errors.items()),
            f"{worse:.2f} times as large",
            partly=worse > A_LITTLE_WORSE,
        ),
        "snr_score": judge(
            fall["losses in training alone"] > LOWER,
            "normalised score at 20 and 5 dB: "
            + ", ".join(f"{name} {values[high]:.3f} and {values[low]:.3f}" for name, values in scores.items()),
            "it falls by " + ", ".join(f"{value:.3f} ({name})" for name, value in fall.items()),
            partly=fall["in the loop too"] > LOWER,
        ),
    }
