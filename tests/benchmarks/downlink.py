"""Commands that are lost or seldom sent: an actuator that holds beside one that plays a buffer.

    python tests/benchmarks/downlink.py            # ten minutes of one core

A cart-pole whose updates all arrive, every slot. Its commands come with d silent slots between two packets, or are each
lost with the probability p. The controller is a model that sees pixels, or the expert on the true state with the
linearised plant as prediction; a packet holds one command, which the actuator holds, or the next 10 or 20, which it
plays. The controller is not told what was applied. Scores are over the normaliser's on the same starts; the
second table has their difference to its first row, seed by seed. 95 % intervals over seeds.

Writes docs/results/downlink.json and .md.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import torch

import tsjepa
from tsjepa.envs import Radio
from tsjepa.envs.settings import Downlink
from tsjepa.evaluation.conditions import plant_of
from tsjepa.evaluation.metrics import interval, normalized_score
from tsjepa.evaluation.rollouts import Loop, every, optimal_scores, run
from tsjepa.support.files import write_text
from tsjepa.support.provenance import provenance

BUFFERS = {"hold": 1, "buffer of 10": 10, "buffer of 20": 20}
SILENT, LOSSES = (0, 1, 2, 3, 4, 5, 9, 19), (0.1, 0.2, 0.3, 0.4, 0.5)  # 9 and 19 are as long as the buffers reach
RESULTS = Path(__file__).parents[2] / "docs" / "results"


def points() -> list[dict]:
    """Silent slots without losses, and losses without silent slots."""
    return [{"silent_slots": d, "loss": 0.0} for d in SILENT] + [{"silent_slots": 0, "loss": p} for p in LOSSES]


def tables(rows: list[dict], command: str) -> str:
    """Scores, and what silence or losses changed of them, in Markdown."""
    explained = " ".join(__doc__.split("\n\n")[2].split())
    names, unharmed = list(rows[0]["scores"]), rows[0]["scores"]
    text = ["# Commands that are lost or seldom sent", "", f"`{command}`. {explained}"]
    for title, differs in (("Score", False), ("Difference to nothing lost", True)):
        text += [
            "",
            f"## {title}",
            "",
            _line(["silent slots", "commands lost", *names]),
            "|---" * (2 + len(names)) + "|",
        ]
        for row in rows:
            cells = [str(row["silent_slots"]), f"{row['loss']:.0%}"]
            for name, values in row["scores"].items():
                base = unharmed[name] if differs else [0.0] * len(values)
                mean, half = interval([value - other for value, other in zip(values, base, strict=True)])
                cells.append(f"{mean:{'+' * differs}.3f} ± {half:.3f}")
            text.append(_line(cells))
    return "\n".join(text) + "\n"


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="tsjepa-cartpole-d16", help="an entry of the zoo")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--starts", type=int, default=10, help="per seed")
    parser.add_argument("--slots", type=int, default=100)
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder of the results")
    arguments = parser.parse_args()
    model = tsjepa.load(arguments.model)
    plant, history = plant_of(model, None), model.frame_history
    loop = Loop(plant, "linear", num_devices=arguments.starts, slots=arguments.slots, frame_history=history)
    optimal = optimal_scores(loop, arguments.seeds)
    controllers = {arguments.model: model, "true state": "linear"}
    loop = every(loop, 1)
    rows = []
    for point in points():
        scores = {}
        for name, controller in controllers.items():
            for actuator, buffer in BUFFERS.items():
                downlink = Downlink(loss=point["loss"], every=point["silent_slots"] + 1, buffer=buffer)
                radio = Radio(lossless=True, downlink=downlink)
                told = replace(loop, controller=controller, radio=radio)
                runs = (run(told, seed) for seed in range(arguments.seeds))
                values = [normalized_score(done.raw_score(), best) for done, best in zip(runs, optimal, strict=True)]
                scores[f"{name}, {actuator}"] = values
        rows.append(point | {"scores": scores})
        print(json.dumps(rows[-1]), flush=True)
    command = f"python tests/benchmarks/downlink.py --seeds {arguments.seeds} --starts {arguments.starts}"
    made = {"made_by": provenance(), "model_sha256": model.entry_sha256, "command": command}
    write_text(arguments.output / "downlink.json", json.dumps(made | {"rows": rows}, indent=1) + "\n")
    write_text(arguments.output / "downlink.md", tables(rows, command))


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
