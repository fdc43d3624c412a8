"""Jumps of several strides beside steps of one slot: prediction error, score, and devices on one radio.

    python tests/benchmarks/hierarchy.py            # 25 to 45 minutes of one core

Both predictors learn on the frozen embeddings of `tsjepa-cartpole-d16` and the same trajectories, from a draw of
their own for each training seed: as many parameters, steps, roll-outs a step and predictions a roll-out. The flat
one is fed its own output over 20 slots; the strides of 1, 5 and 20 jump 10, 8 and 2 times, with and without a loss
term by which jumps over the same slots agree. In the loop the largest stride that ends in a slot predicts it. Of
each there are three training seeds of 8000 steps on 1500 trajectories of 100 slots; scores are means over 5 sets of
20 starts, with one slot without force before the first (the zoo's card has three), and fleets are served by
channel_aware on 10 resource blocks for 4 s under process noise of .008, 5 seeds. Writes docs/results/hierarchy.json
and .md; what is done stands in a journal beside the models, so that a second start goes on.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import torch
from tensordict import TensorDict

import tsjepa
from tsjepa.data.collect import Split, collect
from tsjepa.data.storage import METADATA, open_split
from tsjepa.envs import Radio
from tsjepa.evaluation.conditions import plant_of
from tsjepa.evaluation.metrics import interval, normalized_score
from tsjepa.evaluation.rollouts import Loop, every, optimal_scores, run
from tsjepa.evaluation.search import SIGNS, crossing
from tsjepa.models import HierarchicalPredictor, Predictor, SemanticController, rollout
from tsjepa.plants import build_plant
from tsjepa.support.files import write_text
from tsjepa.support.journal import Journal
from tsjepa.support.provenance import machine, provenance
from tsjepa.training.embeddings import embed_split
from tsjepa.training.finish.hierarchy import fit_hierarchy
from tsjepa.training.finish.refine import refine_predictor
from tsjepa.training.statistics import mean_and_std

AGES, PERIODS = (1, 5, 10, 20, 30, 50), (5, 10, 20, 50)
STRIDES, JUMPS, HORIZON = (1, 5, 20), (10, 8, 2), 20
FLAT, JUMPING, APART, SHIPPED = "flat", "strides", "strides, no agreement", "flat, as shipped"
LEARNING_RATE, BATCH, START_SHARE = 2e-3, 256, 0.3
SLOTS, SPLITS = 100, ("train", "validation")
ACCEPTABLE, NOISE, BLOCKS, FLEET_SLOTS = 0.74, 0.008, 10, 200
RESULTS = Path(__file__).parents[2] / "docs" / "results"


def widths(model: SemanticController) -> list[int]:
    """Equal hidden widths of the strides that have together the parameters of the entry's predictor."""
    wanted, d, m = count(model.predictor), model.embedding_dim, model.spec.action_dim
    each_unit = sum(2 * d + stride * m + 1 for stride in STRIDES)
    return [round((wanted - len(STRIDES) * d) / each_unit)] * len(STRIDES)


def count(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def drawn(kind: str, model: SemanticController, seed: int) -> torch.nn.Module:
    """A predictor that has learned nothing."""
    torch.manual_seed(seed)
    d, m = model.embedding_dim, model.spec.action_dim
    if kind == FLAT:
        return Predictor(d, model.predictor.hidden_dim, action_dim=m)
    return HierarchicalPredictor(d, widths(model), STRIDES, m)


def trained(kind: str, model: SemanticController, embedded: TensorDict, steps: int, seed: int) -> torch.nn.Module:
    """The predictor of a training seed."""
    predictor = drawn(kind, model, seed)
    mean, std = mean_and_std(embedded["action"][:, :-1].flatten(0, 1))
    predictor.command_mean.copy_(mean)
    predictor.command_std.copy_(std)
    if kind == FLAT:
        refine_predictor(predictor, embedded, steps, HORIZON, BATCH, LEARNING_RATE, seed, START_SHARE)
    else:
        weight = 0.0 if kind == APART else 0.5
        fit_hierarchy(predictor, embedded, steps, JUMPS, BATCH, LEARNING_RATE, seed, START_SHARE, weight)
    return predictor.eval().requires_grad_(False)


@torch.no_grad()
def errors(predictor: torch.nn.Module, model: SemanticController, embedded: TensorDict) -> dict:
    """By age: 1 - cosine to the true embedding, and how far the probed state is from the true one's, RMSE."""
    embedding, action = embedded["embedding"], embedded["action"]
    longest = max(AGES)
    begins = range(0, embedding.shape[1] - longest, 7)
    start = torch.stack([embedding[:, begin] for begin in begins])
    commands = torch.stack([action[:, begin : begin + longest] for begin in begins])
    true = torch.stack([embedding[:, begin + 1 : begin + longest + 1] for begin in begins])
    told = rollout(predictor, start, commands)
    apart = 1 - torch.nn.functional.cosine_similarity(told, true, dim=-1).mean((0, 1))
    read = (model.probe(told) - model.probe(true)).square().mean((0, 1)).sqrt()
    return {str(age): [float(apart[age - 1]), *read[age - 1].tolist()] for age in AGES}


def scores(model: SemanticController, seeds: int, starts: int) -> dict:
    """By update period: mean score and interval over evaluation seeds, and failures."""
    loop = Loop(plant_of(model, None), model, num_devices=starts, frame_history=model.frame_history)
    optimal, found = optimal_scores(loop, seeds), {}
    for period in PERIODS:
        runs = [run(every(loop, period), seed) for seed in range(seeds)]
        values = [normalized_score(done.raw_score(), best) for done, best in zip(runs, optimal, strict=True)]
        found[str(period)] = [*interval(values), int(sum(done.failed().sum() for done in runs))]
    return found


def devices(model: SemanticController, sizes: list[int], seeds: int) -> dict:
    """Mean scores of fleets under channel_aware, and the size at which they cross what is acceptable."""
    described = model.plant | {"init_args": {**model.plant["init_args"], "process_noise_std": NOISE}}
    plant, radio = build_plant(described), Radio(resource_blocks=BLOCKS)
    loop = Loop(plant, model, "channel_aware", max(sizes), FLEET_SLOTS, radio)
    optimal, curve = optimal_scores(loop, seeds), {}
    for size in sizes:
        runs = [run(replace(loop, num_devices=size), seed) for seed in range(seeds)]
        values = [normalized_score(done.raw_score(), best[:size]) for done, best in zip(runs, optimal, strict=True)]
        curve[size] = sum(values) / seeds
    served, bound = crossing(curve, ACCEPTABLE)
    return {"curve": curve, "devices": served, "bound": bound}


def table(rows: dict[str, dict], command: str) -> str:
    """The rows in Markdown: means over training seeds, and the smallest and largest of them."""
    kinds = list(dict.fromkeys(row["kind"] for row in rows.values()))
    text = " ".join(__doc__.split("\n\n")[2].split()).split(" Writes ")[0]
    lines = ["# Prediction at several strides", "", f"`{command}`. {text}", ""]
    for title, of, shown in (
        ("1 - cosine to the true embedding after so many slots, coverage trajectories", ("errors", AGES), 0),
        ("probed angle's RMSE after so many slots, rad", ("errors", AGES), 2),
        ("score with an update every so many slots", ("scores", PERIODS), 0),
        ("failures with an update every so many slots", ("scores", PERIODS), 2),
    ):
        lines += [f"| {title} | " + " | ".join(map(str, of[1])) + " |", "|---|" + "---|" * len(of[1])]
        for kind in kinds:
            own = [row[of[0]] for row in rows.values() if row["kind"] == kind and of[0] in row]
            if own:
                cells = [spread([row[str(column)][shown] for row in own]) for column in of[1]]
                lines.append(f"| {kind} | " + " | ".join(cells) + " |")
        lines.append("")
    served = [(kind, [r["fleet"] for r in rows.values() if r["kind"] == kind and "fleet" in r]) for kind in kinds]
    lines += ["| devices at .74, by training seed | |", "|---|---|"]
    for kind, fleets in served:
        if fleets:
            each = ", ".join(f"{SIGNS[fleet['bound']]} {fleet['devices']:.0f}".strip() for fleet in fleets)
            lines.append(f"| {kind} | {each} |")
    return "\n".join([*lines, "", verdict(rows)]) + "\n"


def verdict(rows: dict[str, dict]) -> str:
    """What the strides are worth against the flat predictor: differences by training seed, with 95 % intervals."""
    of = {kind: [row for row in rows.values() if row["kind"] == kind] for kind in (FLAT, JUMPING)}
    if len(of[FLAT]) < 2:
        return "One training seed says nothing of a difference."
    found = []
    for what, columns, sign in (("errors", AGES, -1), ("scores", PERIODS, 1)):
        for column in columns:
            values = ([row[what][str(column)][0] for row in of[kind]] for kind in (JUMPING, FLAT))
            mean, half = interval([sign * (strides - flat) for strides, flat in zip(*values, strict=True)])
            better = "better" if mean > half else "worse" if mean < -half else "no different"
            found.append(f"{what[:-1]} at {column}: {better} ({sign * mean:+.3f} ± {half:.3f})")
    fleets = ([row["fleet"]["devices"] for row in of[kind]] for kind in (JUMPING, FLAT))
    mean, half = interval([strides - flat for strides, flat in zip(*fleets, strict=True)])
    served = "more" if mean > half else "fewer" if mean < -half else "no more and no fewer"
    return (
        f"**Strides less flat, paired by training seed.** {'; '.join(found)}. Channel-aware serves {served} devices "
        f"({mean:+.1f} ± {half:.1f})."
    )


def spread(values: list[float]) -> str:
    """Mean, with the smallest and the largest of several training seeds."""
    shape = "{:.0f}" if all(float(value).is_integer() for value in values) else "{:.3f}"
    mean = shape.format(sum(values) / len(values))
    return mean if len(values) == 1 else f"{mean} ({shape.format(min(values))} to {shape.format(max(values))})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="tsjepa-cartpole-d16", help="an entry of the zoo")
    parser.add_argument("--steps", type=int, default=8000, help="of a predictor")
    parser.add_argument("--training_seeds", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=5, help="of the evaluation")
    parser.add_argument("--starts", type=int, default=20, help="per seed")
    parser.add_argument("--sizes", type=int, nargs="+", default=[60, 100, 140], help="of the fleets")
    parser.add_argument("--fleet_seeds", type=int, default=5)
    parser.add_argument("--episodes", type=int, nargs=2, default=[1500, 40], help="for training and for its errors")
    parser.add_argument("--work", type=Path, default=Path("runs/hierarchy"), help="data set, models and journal")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder of the results")
    arguments = parser.parse_args()
    model, work = tsjepa.load(arguments.model), arguments.work
    data = work / "data"
    if not (data / METADATA).is_file():
        splits = {name: Split(count) for name, count in zip(SPLITS, arguments.episodes, strict=True)}
        collect(str(data), build_plant(model.plant), splits, SLOTS, warmup_slots=model.frame_history - 1)
    embedded = {name: embed_split(model.encoder, open_split(data, name), model.frame_spacing) for name in SPLITS}
    given = {name: str(value) for name, value in vars(arguments).items() if name not in ("episodes", "work", "output")}
    journal = Journal(work / "rows.journal", given | {"model": model.entry_sha256})
    training = range(arguments.training_seeds)
    todo = [*((kind, seed) for seed in training for kind in (FLAT, JUMPING)), (SHIPPED, 0)]
    todo += [(APART, seed) for seed in training]
    shipped = model.predictor
    for kind, seed in todo:
        key = f"{kind}, {seed}"
        if key in journal.done:
            continue
        model.predictor = shipped
        if kind != SHIPPED:
            model.predictor = trained(kind, model, embedded["train"], arguments.steps, seed)
        row = {"kind": kind, "seed": seed, "parameters": count(model.predictor)}
        row["errors"] = errors(model.predictor, model, embedded["validation"])
        if kind != APART:
            row["scores"] = scores(model, arguments.seeds, arguments.starts)
            row["fleet"] = devices(model, arguments.sizes, arguments.fleet_seeds)
        journal.add(key, row)
        print(json.dumps(row), flush=True)
    made = {"made_by": provenance(), "machine": machine(), "model_sha256": model.entry_sha256}
    rows = {key: journal.done[key] for key in (f"{kind}, {seed}" for kind, seed in todo)}
    write_text(arguments.output / "hierarchy.json", json.dumps(made | {"rows": rows}, indent=1) + "\n")
    write_text(arguments.output / "hierarchy.md", table(rows, f"python tests/benchmarks/{made['made_by']['command']}"))


if __name__ == "__main__":
    main()
