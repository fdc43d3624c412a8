"""Commands that are lost or seldom sent: an actuator that holds beside one that plays a buffer.

    python tests/benchmarks/downlink.py            # some ten minutes of one core

A cart-pole whose updates all arrive, every slot. Its commands come with d silent slots between two packets, or are each
lost with the probability p. The controller is a model that sees pixels, or the expert on the true state with the
linearised plant as prediction; a packet holds one command, which the actuator holds, or the next 10 or 20, which it
plays. The controller is not told what was applied. Scores are over the normaliser's on the same starts; intervals over
seeds. Writes docs/results/downlink.json and .md.
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
SILENT, LOSSES = range(6), (0.1, 0.2, 0.3, 0.4, 0.5)
RESULTS = Path(__file__).parents[2] / "docs" / "results"


def points() -> list[dict]:
    """Silent slots without losses, and losses without silent slots."""
    return [{"silent_slots": d, "loss": 0.0} for d in SILENT] + [{"silent_slots": 0, "loss": p} for p in LOSSES]


def table(rows: list[dict], command: str) -> str:
    names = list(rows[0]["scores"])
    explained = " ".join(__doc__.split("\n\n")[2].split())
    lines = ["# Commands that are lost or seldom sent", "", f"`{command}`. {explained}", ""]
    lines.append("| silent slots | commands lost | " + " | ".join(names) + " |")
    lines.append("|---|---|" + "---|" * len(names))
    for row in rows:
        cells = [f"{mean:.3f} ± {half:.3f}" for mean, half in row["scores"].values()]
        lines.append(f"| {row['silent_slots']} | {row['loss']:.0%} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="tsjepa-cartpole-d16", help="an entry of the zoo")
    parser.add_argument("--seeds", type=int, default=3)
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
                scores[f"{name}, {actuator}"] = interval(values)
        rows.append(point | {"scores": scores})
        print(json.dumps(rows[-1]), flush=True)
    command = f"python tests/benchmarks/downlink.py --seeds {arguments.seeds} --starts {arguments.starts}"
    made = {"made_by": provenance(), "model_sha256": model.entry_sha256, "command": command}
    write_text(arguments.output / "downlink.json", json.dumps(made | {"rows": rows}, indent=1) + "\n")
    write_text(arguments.output / "downlink.md", table(rows, command))


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
