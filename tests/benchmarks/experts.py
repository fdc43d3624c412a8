"""The cart-pole's experts on score, cost and failures, and the zoo's scores against another normaliser.

    python tests/benchmarks/experts.py            # about two minutes of one core

Every expert is told the true state in every slot, or its command is held for two, from the evaluation's held-out
starts: 5 seeds x 100, 100 slots of 20 ms, with and without process noise of .008 on both velocities. Differences are
paired by seed. Below, the scores on the zoo's cards, normalised as there and by the searched law on the same starts.
Writes docs/results/experts.json and .md.
"""

import argparse
import json
from pathlib import Path

from tsjepa.evaluation.metrics import interval
from tsjepa.evaluation.rollouts import Loop, every, perfect_feedback, run
from tsjepa.models import entries
from tsjepa.plants import CartPole, build_plant
from tsjepa.plants.cartpole import SEARCHED
from tsjepa.support.files import write_text
from tsjepa.support.provenance import machine, provenance
from tsjepa.zoo.figures import own_rows

NOISES, HELD = (0.0, 0.008), (1, 2)
PERIODS = (1, 5, 10, 20)
RESULTS = Path(__file__).parents[2] / "docs" / "results"


def figures(loop: Loop, expert: str, held: int, seeds: int) -> dict:
    """Of an expert with perfect feedback whose command is held for ``held`` slots."""
    told = every(perfect_feedback(loop, expert), held)
    runs = [run(told, seed) for seed in range(seeds)]
    return {
        "expert": expert,
        "held_slots": held,
        "score_per_seed": [float(done.raw_score().mean()) for done in runs],
        "cost_per_seed": [float(done.quadratic_cost().mean()) for done in runs],
        "failures": sum(int(done.failed().sum()) for done in runs),
        "starts": seeds * loop.num_devices,
    }


def against(one: dict, other: dict) -> tuple[float, float]:
    """How much more ``one`` scores than ``other``, with its interval over seeds."""
    return interval([a - b for a, b in zip(one["score_per_seed"], other["score_per_seed"], strict=True)])


def cards(limit: int | None = None) -> list[dict]:
    """The cart-pole entries' scores by period, normalised as on the card and by the searched law on the same starts."""
    found, raw = [], {}
    for name in entries.names():
        model = entries.load(name)
        metrics = model.metrics
        if not str((metrics.get("plant") or {}).get("class_path")).endswith(".CartPole"):
            continue
        plant = build_plant(metrics["plant"])
        seeds, starts = len(metrics["seeds"]), metrics["starts_per_seed"]
        loop = Loop(plant, num_devices=starts, slots=metrics["slots"], frame_history=metrics["frame_history"])
        for expert in (metrics["optimal_policy"], SEARCHED):
            key = (expert, seeds, starts, metrics["slots"], metrics["frame_history"])
            raw[key] = raw.get(key) or figures(loop, expert, 1, seeds)["score_per_seed"]
        known, searched = (
            raw[(expert, seeds, starts, metrics["slots"], metrics["frame_history"])]
            for expert in (metrics["optimal_policy"], SEARCHED)
        )
        row = {"entry": name, "normaliser": metrics["optimal_policy"]}
        for period, scored in own_rows(metrics).items():
            if period in PERIODS:
                both = [score * a / b for score, a, b in zip(scored["per_seed"], known, searched, strict=True)]
                row[f"every {period}"] = {"card": interval(scored["per_seed"]), "searched": interval(both)}
        found.append(row)
        if len(found) == limit:
            break
    return found


def table(rows: list[dict], shipped: list[dict], command: str) -> str:
    said = " ".join(__doc__.split("\n\n")[2].split()).partition(" Writes ")[0]
    lines = ["# The cart-pole's experts", "", f"`{command}`. {said}", ""]
    lines += ["| noise | expert | command held for | score | more than the normaliser | cost | failures |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for row in rows:
        wanted = row["noise"], CartPole.normaliser, 1
        base = next(other for other in rows if (other["noise"], other["expert"], other["held_slots"]) == wanted)
        mean, half = interval(row["score_per_seed"])
        more, width = against(row, base)
        cells = [f"{row['noise']:g}", row["expert"], str(row["held_slots"]), f"{mean:.4f} ± {half:.4f}"]
        cells += ["-" if row is base else f"{more:+.4f} ± {width:.4f}", f"{interval(row['cost_per_seed'])[0]:.1f}"]
        lines.append("| " + " | ".join([*cells, f"{row['failures']} of {row['starts']}"]) + " |")
    lines += [
        "",
        reading(rows),
        "",
        "| entry | normalised by | " + " | ".join(f"every {period}" for period in PERIODS) + " |",
    ]
    lines += ["|---|---|" + "---|" * len(PERIODS)]
    for row in shipped:
        for key, named in (("card", row["normaliser"]), ("searched", SEARCHED)):
            values = [row.get(f"every {period}") for period in PERIODS]
            cells = ["-" if value is None else "{:.3f} ± {:.3f}".format(*value[key]) for value in values]
            lines.append(f"| `{row['entry']}` | {named} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def reading(rows: list[dict]) -> str:
    """What the first table says of the searched law, in words."""
    quiet = {(row["expert"], row["held_slots"]): row for row in rows if row["noise"] == 0}
    law, held, other = quiet[SEARCHED, 1], quiet[SEARCHED, 2], quiet[CartPole.normaliser, 1]
    more, width = against(law, other)
    share = interval(law["score_per_seed"])[0] / interval(other["score_per_seed"])[0]
    cost = interval(law["cost_per_seed"])[0] / interval(other["cost_per_seed"])[0]
    return (
        "The searched law (`tests/benchmarks/search_expert.py`, chosen on other starts) scores "
        f"{share:.2f} times as much as the normaliser ({more:+.3f} ± {width:.3f} without noise), at {cost:.1f} times "
        f"the quadratic cost. It needs every slot: held for two, {held['failures']} of {held['starts']} starts fail. "
        "So it measures what a score of 1 leaves open; recorded scores keep their normaliser."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--starts", type=int, default=100, help="per seed")
    parser.add_argument("--entries", type=int, help="of the zoo at most")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder of the results")
    arguments = parser.parse_args()
    rows = []
    for noise in NOISES:
        plant = CartPole(process_noise_std=noise)
        loop = Loop(plant, num_devices=arguments.starts)
        for expert in plant.experts():
            rows += [{"noise": noise} | figures(loop, expert, held, arguments.seeds) for held in HELD]
    shipped = cards(arguments.entries)
    command = f"python tests/benchmarks/experts.py --seeds {arguments.seeds} --starts {arguments.starts}"
    result = {"made_by": provenance(), "machine": machine(), "rows": rows, "cards": shipped}
    write_text(arguments.output / "experts.json", json.dumps(result, indent=1) + "\n")
    write_text(arguments.output / "experts.md", table(rows, shipped, command))
    print(table(rows, shipped, command))


if __name__ == "__main__":
    main()
