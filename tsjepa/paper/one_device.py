"""Encoding and prediction with one device (paper fig_ts-jepa_pred)."""

from __future__ import annotations

from pathlib import Path

from tsjepa.evaluation.rollouts import ONCE
from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict, judge
from tsjepa.paper.devices import ACCEPTABLE
from tsjepa.paper.rows import CURVE_STEP, command_rows, loop_rows
from tsjepa.paper.store import flat

TITLE = "Encoding and prediction, one device"
CAPTION = (
    "Every controller with an update in every slot, every few slots, and once, at the first slot; between updates it "
    "predicts (TS-JEPA), repeats its last command, or sends none. Command error (NMAE, over 40 N): its commands "
    "beside those of the expert that drives; a controller that predicts imagines the loop. Normalised score: it "
    "drives itself, against the reference LQR with perfect feedback from the same starts; nothing counts after a "
    "fall. Bits are those of the real "
    "packets: embeddings as fp32, frames of the supervised controllers as raw pixels, the expert's state as fp32. 95 "
    "% intervals over seeds."
)
MEASURES = ("score", "nmae")
OPTIMAL, OURS, TWO, FOUR, AUTOENCODER = "optimal", "TS-JEPA", "supervised 2", "supervised 4", "autoencoder"
NEAR = 0.95  # of the score of the expert on the true state
FEWER_FALLS = 0.05  # share of the starts by which a controller has to be ahead
AHEAD = 0.05  # in normalised score
LOWER_ERROR, LOWER_COST = 0.8, 0.9  # of the best baseline's command error and cost
FEWER_BITS = 10.0  # times
SLIGHT, LARGE = 2.0, 4.0  # growth of the command error over the horizon, times
STYLES = {"predict": "-", "hold": "--", "zero": ":"}


def points(controllers: list[dict], update_every: list[int], sizes: dict) -> list[dict]:
    """The sweep: every controller at every period; zero action only where it is sent once, prediction only ours.

    Args:
        controllers: ``label``, ``model``, ``sends``, ``codec``.
        update_every: slots between updates; 0 is once.
        sizes: ``seeds``, ``starts``, ``slots``, ``process_noise_std``.
    """
    return [
        controller | {"update_every": period, "between": between} | sizes
        for period in update_every
        for controller in controllers
        for between in STYLES
        if (between == "hold" or period != 1)
        and (between != "zero" or period == ONCE)
        and (between != "predict" or controller["label"] == OURS)
    ]


def evaluate(point: dict) -> list[dict]:
    """Closed loop and command error, one row a seed."""
    return [loop | error for loop, error in zip(loop_rows(point), command_rows(point), strict=True)]


def draw(records: list[dict], path: str | Path) -> None:
    """Command error, bits and score: in every slot, sent once over the horizon, and against the update period."""
    rows = flat(records)
    labels = plots.distinct(plots.select(rows, update_every=1), "label")
    colors = {label: plots.color_of(label) for label in labels}
    figure, axes = plots.canvas(columns=3, rows=2, width=4.6)
    fresh = [plots.select(rows, label=label, update_every=1) for label in labels]
    for axis, (measure, name) in zip(
        axes,
        (
            ("nmae", plots.NMAE),
            ("bits_per_slot", "payload (bits per slot)"),
            ("score", plots.SCORE),
        ),
        strict=False,
    ):
        plots.bars(axis, labels, fresh, measure, list(colors.values()))
        axis.set(xlabel=name, title="update in every slot", xscale="log" if measure == "bits_per_slot" else "linear")
    for label in labels:
        for between, style in STYLES.items():
            once = plots.select(rows, label=label, update_every=ONCE, between=between)
            if not once:
                continue
            for axis, measure in ((axes[3], "nmae_by_slot"), (axes[4], "in_box")):
                curve = plots.curve(once, measure)
                slots = [CURVE_STEP * (index + 0.5) for index in range(len(curve))]
                axis.plot(
                    slots, curve, color=colors[label], linestyle=style, label=f"{label}, {between}", linewidth=1.2
                )
        for between in ("predict", "hold"):
            groups = [
                (
                    period,
                    plots.select(rows, label=label, update_every=period, between=between if period != 1 else "hold"),
                )
                for period in sorted(set(plots.distinct(rows, "update_every")) - {ONCE})
            ]
            groups = [(period, seeds) for period, seeds in groups if seeds]
            if len(groups) > 1:
                plots.errorbar(
                    axes[5],
                    groups,
                    "score",
                    color=colors[label],
                    linestyle=STYLES[between],
                    label=f"{label}, {between}",
                )
    axes[3].set(xlabel="time since the only update (slots)", ylabel=plots.NMAE, title="one update: command error")
    axes[4].set(
        xlabel="time since the only update (slots)", ylabel="starts in the box (share)", title="one update: score"
    )
    axes[5].set(xlabel="time between updates (slots)", ylabel=plots.SCORE, xscale="log", title="rare updates")
    plots.legend(figure, axes[3:], columns=4)
    plots.save(figure, path, "What do encoding and prediction give one device?")


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """What the claims about one device come to, as far as their controllers are recorded."""
    rows = flat(records)

    def of(label: str, period: int = 1, between: str = "hold") -> list[dict]:
        return plots.select(rows, label=label, update_every=period, between=between)

    ours, optimal = of(OURS), of(OPTIMAL)
    learned = {label: of(label) for label in (TWO, FOUR, AUTOENCODER) if of(label)}
    if not ours or not optimal:
        return {}
    error = {label: plots.mean(seeds, "nmae") for label, seeds in ({OURS: ours} | learned).items()}
    score = {label: plots.mean(seeds, "score") for label, seeds in ({OURS: ours, OPTIMAL: optimal} | learned).items()}
    bits = {label: plots.mean(seeds, "bits_per_slot") for label, seeds in ({OURS: ours} | learned).items()}
    found = {
        "near_optimal": judge(
            score[OURS] >= NEAR * score[OPTIMAL],
            f"score {plots.text(ours, 'score')}, the expert on the true state {plots.text(optimal, 'score')}",
            f"it stays {1 - score[OURS] / score[OPTIMAL]:.0%} below the expert on the true state",
            partly=score[OURS] >= ACCEPTABLE,
        )
    }
    pairs = {period: (of(OURS, period, "predict"), of(OURS, period, "hold")) for period in (2, 5, 10)}
    pairs = {period: pair for period, pair in pairs.items() if all(pair)}
    if pairs:
        fewer = {
            period: plots.mean(held, "failed") - plots.mean(predicted, "failed")
            for period, (predicted, held) in pairs.items()
        }
        short = [f"{period}" for period, share in fewer.items() if share <= FEWER_FALLS]
        found["prediction_helps"] = judge(
            not short,
            "; ".join(
                f"with an update every {period} slots predicting scores {plots.text(predicted, 'score')} and "
                f"{plots.mean(predicted, 'failed'):.0%} fall, repeating the last command {plots.text(held, 'score')} "
                f"and {plots.mean(held, 'failed'):.0%}"
                for period, (predicted, held) in pairs.items()
            ),
            f"with an update every {' and '.join(short)} slots it saves no more than {FEWER_FALLS:.0%} from falling",
            partly=len(short) < len(fewer),
        )
    if learned:
        found |= _beside_learned(error, score, bits, learned, ours)
    found |= _sent_once(of)
    return found


def _beside_learned(error: dict, score: dict, bits: dict, learned: dict, ours: list[dict]) -> dict[str, Verdict]:
    cost = {label: plots.mean(seeds, "cost") for label, seeds in ({OURS: ours} | learned).items()}
    errors, scores, costs = (
        ", ".join(f"{label} {value:.{digits}f}" for label, value in figures.items())
        for figures, digits in ((error, 4), (score, 3), (cost, 1))
    )
    close = [label for label, seeds in learned.items() if sum(plots.lead(ours, seeds, "nmae")) >= 0]
    best = min(learned, key=lambda label: error[label])
    cheapest = min(learned, key=lambda label: cost[label])
    dearer, half = plots.lead(ours, learned[cheapest], "cost")
    cost_lead = f"{dearer:.1f} ± {half:.1f}"
    frames = [bits[label] for label in (TWO, FOUR) if label in bits]
    found = {
        "lowest_nmae": judge(
            not close,
            f"command NMAE: {errors}",
            f"not clearly below {' and '.join(close)}",
            partly=error[OURS] < max(error.values()),
        ),
        "beats_baselines_prediction": judge(
            error[OURS] < LOWER_ERROR * error[best],
            f"command NMAE with an update in every slot: {errors}",
            f"{error[OURS] / error[best]:.2f} times the error of {best}",
            partly=not close,
        ),
        "beats_baselines_cost": judge(
            cost[OURS] < LOWER_COST * cost[cheapest],
            f"quadratic cost with an update in every slot: {costs}; beside {cheapest} {cost_lead}",
            f"{cost[OURS] / cost[cheapest]:.2f} times the cost of {cheapest}",
            partly=dearer + half < 0,
        ),
    }
    if frames:
        saved = f"bits per slot: {bits[OURS]:.0f} as fp32 embedding, raw frames {min(frames):.0f}"
        few, times = bits[OURS] < min(frames) / FEWER_BITS, f"only {min(frames) / bits[OURS]:.1f} times fewer"
        found["far_fewer_bits"] = judge(few, saved, times)
        found["beats_baselines_bits"] = judge(
            few, saved + "; against coded frames see the figure of bits against score", times
        )
    if AUTOENCODER in learned and TWO in learned:
        lead, half = plots.lead(learned[AUTOENCODER], learned[TWO], "score")
        above = lead > half
        worse = error[AUTOENCODER] > error[OURS]
        found["autoencoder_order"] = judge(
            worse and above,
            f"command NMAE: {errors}; scores: {scores}; autoencoder over {TWO} {lead:.3f} ± {half:.3f}",
            "; ".join(
                ["its error is not higher"] * (not worse)
                + ["it does not clearly score above the supervised controller"] * (not above)
            ),
            partly=worse or above,
        )
    if TWO in learned:
        found["supervised_generalises"] = judge(
            score[TWO] < ACCEPTABLE,
            f"score {score[TWO]:.3f} from starts that it was not trained on, command NMAE {error[TWO]:.4f}; TS-JEPA "
            f"{score[OURS]:.3f} and {error[OURS]:.4f}",
            f"it scores more than {ACCEPTABLE}",
            partly=sum(plots.lead(learned[TWO], ours, "score")) < 0,
        )
    if TWO in learned and FOUR in learned:
        better = error[FOUR] < error[TWO]
        found["more_frames"] = judge(
            better and bits[FOUR] > bits[TWO],
            f"command NMAE {error[TWO]:.4f} and {error[FOUR]:.4f}, score {score[TWO]:.3f} and {score[FOUR]:.3f}, "
            f"{bits[TWO]:.0f} and {bits[FOUR]:.0f} bits with 2 and 4 frames",
            "four frames do not lower the command error" if not better else "four frames need no more bits",
            partly=bits[FOUR] > bits[TWO],
        )
    return found


def _sent_once(of) -> dict[str, Verdict]:
    ours = of(OURS, ONCE, "predict")
    rivals = {
        f"{label}, {between}": of(label, ONCE, between)
        for label in (OPTIMAL, TWO, FOUR, AUTOENCODER)
        for between in ("hold", "zero")
        if of(label, ONCE, between)
    }
    if not ours or not rivals:
        return {}
    best_error = min(rivals, key=lambda name: plots.mean(rivals[name], "nmae"))
    best_score = max(rivals, key=lambda name: plots.mean(rivals[name], "score"))
    curve, rival_curves = plots.curve(ours, "nmae_by_slot"), [plots.curve(r, "nmae_by_slot") for r in rivals.values()]
    ahead = sum(mine < min(others) for mine, *others in zip(curve, *rival_curves, strict=True))
    our_score, their_score = plots.mean(ours, "score"), plots.mean(rivals[best_score], "score")
    ahead_in_score = our_score > their_score + AHEAD
    short = [f"less than {AHEAD} ahead of {best_score}"] * (not ahead_in_score)
    short += [f"below the acceptable {ACCEPTABLE}"] * (our_score < ACCEPTABLE)
    begins, ends = curve[0], sum(curve[-4:]) / 4
    return {
        "once_growth": judge(
            ends < SLIGHT * begins,
            f"command NMAE {begins:.4f} in the first {CURVE_STEP} slots, {ends:.4f} in the last {4 * CURVE_STEP}",
            f"it grows {ends / begins:.1f}-fold",
            partly=ends < LARGE * begins,
        ),
        "once_nmae": judge(
            ahead == len(curve),
            f"command NMAE over 2 s {plots.text(ours, 'nmae', 4)}, {best_error} "
            f"{plots.text(rivals[best_error], 'nmae', 4)}; ours is the lowest in {ahead} of {len(curve)} stretches of "
            f"{CURVE_STEP} slots",
            f"not the lowest in {len(curve) - ahead} of {len(curve)} stretches",
            partly=2 * ahead >= len(curve) or plots.mean(ours, "nmae") < plots.mean(rivals[best_error], "nmae"),
        ),
        "once_score": judge(
            not short,
            f"normalised score {plots.text(ours, 'score')}, {best_score} {plots.text(rivals[best_score], 'score')}",
            " and ".join(short),
            partly=ahead_in_score,
        ),
    }
