"""Whether predicted success is what happens, and whether knowing the channel helps control.

    python tests/benchmarks/calibration.py              # about a minute of one core
    python tests/benchmarks/calibration.py --control    # and the closed loops, ten minutes

For every kind of knowledge and of channel: the success that channel_aware is told of the devices that it schedules, and
the share that is delivered (8 networks of 60 devices, 6 blocks, 300 slots after 100; mean SNR 10 dB, threshold 5 dB).
With --control: the score of a fleet of cart-poles whose expert holds its command, under channel_aware and max_age, on
the same plants and channels. Writes docs/results/calibration.json and .md.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import torch
from network import NoPlant
from torchrl.envs import Compose, TransformedEnv

from tsjepa.envs import Radio
from tsjepa.envs.transforms import Channel, Scheduler, Uplink
from tsjepa.evaluation.metrics import interval, normalized_score
from tsjepa.evaluation.rollouts import Loop, perfect_feedback, run
from tsjepa.plants import CartPole
from tsjepa.radio import GilbertElliott
from tsjepa.radio.schedulers import channel_aware
from tsjepa.support.files import write_text
from tsjepa.support.provenance import provenance

WALK_HZ = 10.4239
BURSTS = GilbertElliott(good_to_bad=0.05, bad_to_good=0.2)
KNOWLEDGE = ("perfect", "delayed", "statistical", "acks")
CHANNELS = {
    "independent": {},
    "Jakes, 3 km/h": {"max_doppler_hz": WALK_HZ},
    "Gilbert-Elliott": {"loss": BURSTS},
}
NETWORKS, DEVICES, BLOCKS, WARM_UP, SLOTS = 8, 60, 6, 100, 300
FLEET = {"independent": 40, "Jakes, 3 km/h": 40, "Gilbert-Elliott": 20}
RESULTS = Path(__file__).parents[2] / "docs" / "results"


def calibration(csi: str, channel: dict) -> dict:
    """Predicted and realised success of what is scheduled, and their difference with its interval over networks."""
    told = []

    def listening(known):
        told.append(known.success)
        return channel_aware(known)

    chain = [Channel(snr_target_db=10.0, **channel), Scheduler(listening, BLOCKS, csi=csi, **channel)]
    env = TransformedEnv(NoPlant([NETWORKS, DEVICES]), Compose(*chain, Uplink(in_key=None)))
    data = env.rollout(WARM_UP + SLOTS, break_when_any_done=False)
    success = torch.stack(told[: WARM_UP + SLOTS], -1)[..., WARM_UP:]
    sent, arrived = data["scheduled"][..., WARM_UP:], data["delivered"][..., WARM_UP:]
    count = sent.sum((1, 2))
    predicted, realised = ((x * sent).sum((1, 2)) / count for x in (success, arrived.double()))
    mean, half = interval((realised - predicted).tolist())
    row = {"predicted": float(predicted.mean()), "realised": float(realised.mean()), "transmissions": int(count.sum())}
    return row | {"difference": mean, "interval_95": half}


def control(csi: str, name: str, seeds: range) -> dict:
    """Normalised scores of both schedulers, and their difference with its interval over seeds."""
    plant = CartPole(sampling_interval=0.02, process_noise_std=0.008)
    radio = Radio(resource_blocks=10, csi=csi, **CHANNELS[name])
    loop = Loop(plant, "hold", num_devices=FLEET[name], slots=100, radio=radio)
    perfect = perfect_feedback(loop, plant.normaliser)
    optimal = {seed: run(perfect, seed).raw_score() for seed in seeds}
    scores = {
        scheduler: [
            normalized_score(run(replace(loop, scheduler=scheduler), seed).raw_score(), optimal[seed]) for seed in seeds
        ]
        for scheduler in ("channel_aware", "max_age")
    }
    mean, half = interval([a - b for a, b in zip(scores["channel_aware"], scores["max_age"], strict=True)])
    means = {scheduler: interval(values)[0] for scheduler, values in scores.items()}
    return {"num_devices": FLEET[name]} | means | {"difference": mean, "interval_95": half}


def table(rows: list[dict], seeds: range) -> str:
    """The rows in Markdown; the closed loops only where they were run."""
    looped = "control" in rows[0]
    options = f" --control --seeds {len(seeds)} --first-seed {seeds.start}" if looped else ""
    text = (
        f"`python tests/benchmarks/calibration.py{options}`. Success that channel_aware is told of the "
        "devices that it schedules, and the share that is delivered: 8 networks of 60 devices, 6 blocks, mean SNR 10 "
        "dB, threshold 5 dB, 300 slots; difference with its 95 % interval over networks."
    )
    titles = ["knowledge", "channel", "predicted", "realised", "difference"]
    if looped:
        text += (
            " Right: score of cart-poles (10 blocks, the expert's command held between updates) under channel_aware "
            "and max_age on the same plants and channels; difference with its 95 % interval over seeds."
        )
        titles += ["devices", "channel_aware", "max_age", "difference"]
    lines = ["# Predicted and realised delivery", "", text, "", _line(titles), "|" + "---|" * len(titles)]
    for row in rows:
        cells = [row["csi"], row["channel"], f"{row['predicted']:.3f}", f"{row['realised']:.3f}"]
        cells.append(f"{row['difference']:+.4f} ± {row['interval_95']:.4f}")
        if looped:
            loop = row["control"]
            cells += [str(loop["num_devices"]), f"{loop['channel_aware']:.3f}", f"{loop['max_age']:.3f}"]
            cells.append(f"{loop['difference']:+.3f} ± {loop['interval_95']:.3f}")
        lines.append(_line(cells))
    return "\n".join(lines) + "\n"


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--control", action="store_true", help="run the closed loops too")
    parser.add_argument("--seeds", type=int, default=30, help="of the closed loops")
    parser.add_argument("--first-seed", type=int, default=0, help="of the closed loops")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder of the results")
    arguments = parser.parse_args()
    rows, seeds = [], range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for name, channel in CHANNELS.items():
        for csi in KNOWLEDGE:
            row = {"csi": csi, "channel": name} | calibration(csi, channel)
            if arguments.control:
                row["control"] = control(csi, name, seeds)
            rows.append(row)
            print(table(rows, seeds).splitlines()[-1], flush=True)
    result = {"made_by": provenance(), "rows": rows}
    write_text(arguments.output / "calibration.json", json.dumps(result, indent=1) + "\n")
    write_text(arguments.output / "calibration.md", table(rows, seeds))


if __name__ == "__main__":
    main()
