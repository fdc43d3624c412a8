"""``tsjepa evaluate``: one controller in closed loop beside its baselines; table, plot, video and raw figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from tqdm import tqdm

from tsjepa.data.storage import read_metadata
from tsjepa.envs.embedding_codec import embedding_codec
from tsjepa.evaluation.closed_loop import ONCE, SemanticPolicy, Starts, planned_policy, run, true_state_policy
from tsjepa.evaluation.metrics import Run, interval, normalized_score
from tsjepa.evaluation.open_loop import open_loop_metrics
from tsjepa.evaluation.pictures import horizon_plot, look_inside, loop_plot
from tsjepa.radio.codecs import payload_bits
from tsjepa.support.checks import at_least, within
from tsjepa.support.files import write_text
from tsjepa.support.provenance import machine, provenance
from tsjepa.zoo.card import kind_of

STATE_BITS = 4 * 32
RAW_FRAME_BITS = 8 * 3 * 64 * 128
ANGLE_LIMIT = 0.05  # rad; a prediction whose probed angle is further off counts as lost
FIRST_SLOT = f"first_slot_angle_error_above_{ANGLE_LIMIT}"
LABELS = {"tsjepa": "TS-JEPA", "supervised": "supervised", "autoencoder": "autoencoder"}


def evaluate(
    model: str,
    output: str = "runs/evaluation",
    data: str | None = "data/cartpole-20ms",
    periods: Sequence[int] = (1, 2, 5, 10, 20, ONCE),
    seeds: int = 5,
    starts_per_seed: int = 20,
    slots: int = 100,
    frame_history: int = 1,
    process_noise_std: float = 0.0,
    blend: float = 1.0,
    codec: Literal["fp32", "fp16", "int8", "int4"] = "fp32",
    video: bool = True,
) -> dict:
    """Closes the loop on held-out starts with an update every P slots and prints how each controller did.

    Args:
        model: name or folder of a zoo entry.
        output: folder for ``evaluation.json``, the plots ``score.png`` and (with a period of 0) ``horizon.png``, and
            what embeddings hold: the film ``loop.mp4`` and the still picture ``inside.png``.
        data: data set whose test split gives command error, probe error and prediction skill; null to leave them out.
        periods: slots between updates; 0 means once, at the first slot.
        seeds: sets of starts, at least 2 (5 for figures that are reported).
        starts_per_seed: starts in each.
        slots: length of a run.
        frame_history: frames up to step 0, the warm-up under zero force; at least those of the model's stack. Models of
            different stacks meet the same starts with the longest one's (4 for the supervised baseline's).
        process_noise_std: standard deviation of the noise on both velocities after every slot (m/s, rad/s).
        blend: how much of a received embedding enters the belief; 1 replaces the prediction.
        codec: how an embedding is sent; the integer ones need ranges that travel with the model.
        video: write the film and the still picture.
    """
    import tsjepa
    from tsjepa.envs import Renderer
    from tsjepa.plants.expert import Expert, reference_lqr

    at_least(2, seeds=seeds)
    at_least(1, starts_per_seed=starts_per_seed, slots=slots, frame_history=frame_history)
    at_least(0, process_noise_std=process_noise_std, **{f"periods[{i}]": period for i, period in enumerate(periods)})
    within(0, 1, blend=blend)
    controller = tsjepa.load(model)
    if data is not None:
        read_metadata(data)  # a missing data set is said before the loops are run
    architecture, own = controller.architecture, LABELS[kind_of(controller)]
    frame_history = max(frame_history, controller.frame_history)
    interval_s = architecture.sampling_interval
    renderer, expert = Renderer(), Expert(interval_s)
    radio = embedding_codec(codec, controller)
    embedding_bits = int(payload_bits(radio.encode(torch.zeros(1, architecture.embedding_dim))))

    def sent(embedding: torch.Tensor) -> torch.Tensor:
        return radio.decode(radio.encode(embedding))

    sets = [Starts(seed, starts_per_seed, slots, frame_history, interval_s, process_noise_std) for seed in range(seeds)]
    laws = {"expert": expert, "reference LQR": reference_lqr(interval_s)}
    feedback = {name: [run(starts, true_state_policy(law, 1)) for starts in sets] for name, law in laws.items()}
    best = max(feedback, key=lambda name: sum(float(loop.raw_score().sum()) for loop in feedback[name]))
    optimal = [loop.raw_score() for loop in feedback[best]]
    rows = [summary("expert, perfect feedback", 1, feedback["expert"], optimal, STATE_BITS, slots)]
    for period in tqdm(periods, desc="closed loops", unit="period"):
        policies = {
            own: partial(SemanticPolicy, controller, renderer.render, period, blend, sent),
            "expert, hold last": partial(true_state_policy, expert, period, "hold"),
            "expert, zero": partial(true_state_policy, expert, period, "zero"),
        }
        if period == ONCE:
            policies["expert, plan sent once"] = partial(planned_policy, expert, interval_s, slots)
        for name, policy in policies.items():
            if period == 1 and name != own:
                continue
            bits = embedding_bits if name == own else STATE_BITS
            if name == own and period == ONCE and architecture.has_predictor:
                loops, errors = zip(*(run_probed(starts, policy()) for starts in sets), strict=True)
                more = angle_figures(torch.cat(errors, dim=1))
            else:
                loops, more = [run(starts, policy()) for starts in sets], {}
            rows.append(summary(name, period, loops, optimal, bits, slots) | more)
            if name == own == LABELS["supervised"]:
                frames = RAW_FRAME_BITS * architecture.frame_stack
                rows[-1]["bits_per_step_as_frames"] = rows[-1]["bits_per_step"] * frames / bits
    result = {
        "made_by": provenance(),
        "machine": machine(),
        "model": model,
        "model_sha256": controller.entry_sha256,
        "codec": codec,
        "optimal_policy": best,
        "optimal_raw_score": float(torch.cat(optimal).mean()),
        "optimal_score_by_slot": score_by_slot(feedback[best]),
        "starts": f"{seeds} seeds x {starts_per_seed}",
        "seeds": list(range(seeds)),
        "starts_per_seed": starts_per_seed,
        "slots": slots,
        "frame_history": frame_history,
        "process_noise_std": process_noise_std,
        "blend": blend,
        "closed_loop": rows,
    }
    if data is not None:
        result["open_loop"] = open_loop_metrics(controller, data)
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "evaluation.json", json.dumps(result, indent=2) + "\n")
    print(table(result))
    loop_plot(rows, folder / "score.png")
    if ONCE in periods:
        horizon_plot(rows, result["optimal_score_by_slot"], folder / "horizon.png")
    if video and not controller.decoder.fitted:
        print("There is no film, because the decoder of this model was never trained.")
    elif video:
        first = Starts(seeds, 1, slots, frame_history, interval_s)
        look_inside(controller, renderer, first, folder / "loop.mp4", folder / "inside.png")
    print(f"Figures, plot and film are in {folder}.")
    return result


@torch.no_grad()
def run_probed(starts: Starts, policy: SemanticPolicy) -> tuple[Run, torch.Tensor]:
    """The closed loop, and the error [T, N] of the angle that the probe reads from each slot's belief, in rad."""
    errors = []

    def watched(slot: int, observation) -> torch.Tensor:
        action = policy(slot, observation)
        errors.append((policy.model.probe(policy.belief)[:, 1] - observation["state"][:, 1]).abs())
        return action

    return run(starts, watched), torch.stack(errors)


def angle_figures(errors: torch.Tensor) -> dict:
    """The mean over starts of errors [T, N], and the first slot where it passes the limit; None if it never does."""
    mean = errors.mean(1)
    above = (mean > ANGLE_LIMIT).nonzero()
    return {
        FIRST_SLOT: int(above[0]) if len(above) else None,
        "angle_error_by_slot": mean.tolist(),
    }


def summary(name: str, period: int, loops: Sequence[Run], optimal: list[torch.Tensor], bits: int, slots: int) -> dict:
    """One row of the table: means over all starts, intervals over seeds."""
    scores = [normalized_score(loop.raw_score(), best) for loop, best in zip(loops, optimal, strict=True)]
    mean, half = interval(scores)
    updates = 1 if period == ONCE else -(-slots // period)
    return {
        "controller": name,
        "update_every": period or "once",
        "normalized_score": mean,
        "interval_95": half,
        "best_seed": max(scores),
        "per_seed": scores,
        "raw_score": float(torch.cat([loop.raw_score() for loop in loops]).mean()),
        "failures": int(torch.cat([loop.failed() for loop in loops]).sum()),
        "starts": sum(len(best) for best in optimal),
        "quadratic_cost": float(torch.cat([loop.quadratic_cost() for loop in loops]).mean()),
        "command_nmae": float(torch.cat([loop.command_nmae() for loop in loops]).mean()),
        "bits_per_step": bits * updates / slots,
        "score_by_slot": score_by_slot(loops),
    }


def score_by_slot(loops: Sequence[Run]) -> list[float]:
    """Share of starts that are in the box after each slot."""
    return torch.cat([loop.in_box() for loop in loops], dim=1).float().mean(1).tolist()


def table(result: dict) -> str:
    """The rows as aligned text."""
    lines = [f"{'controller':<26}{'update':>7}{'score':>16}{'raw':>7}{'fail':>9}{'cost':>9}{'NMAE':>8}{'bit/step':>10}"]
    for row in result["closed_loop"]:
        lines.append(
            f"{row['controller']:<26}{row['update_every']:>7}{row['normalized_score']:>8.3f} ± {row['interval_95']:.3f}"
            f"{row['raw_score']:>7.3f}{row['failures']:>5}/{row['starts']:<3}{row['quadratic_cost']:>9.1f}"
            f"{row['command_nmae']:>8.4f}{row['bits_per_step']:>10.0f}"
        )
        if FIRST_SLOT in row:
            slot = "never" if row[FIRST_SLOT] is None else f"from slot {row[FIRST_SLOT]}"
            lines.append(f"  probed angle more than {ANGLE_LIMIT} rad off: {slot}")
    if "open_loop" in result:
        lines += ["", *(f"{name}: {value}" for name, value in result["open_loop"].items())]
    return "\n".join(lines)
