"""One table of all benchmarks, from the figures in docs/results.

python tests/benchmarks/table.py            # prints it and writes docs/results/benchmarks.md
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tsjepa.support.files import write_text

MEMORY_GROWTH_PERCENT = 2
OLD = "c00b92b"  # the last of version 0.1, as commits.py has it


@dataclass
class Row:
    """One line.

    Args:
        name: what is measured.
        figure: how fast it is, with its unit.
        beside: the peer or the limit, with its figure.
        ratio: spread of ours to it, by rounds, or one number.
        target: for ``value``; None where there is none.
        value: what has to reach the target; None if it never got there.
        at_most: the target is an upper limit.
        unit: of the target, where it is no ratio.
    """

    name: str
    figure: str
    beside: str = ""
    ratio: dict | float | None = None
    target: float | None = None
    value: float | None = None
    at_most: bool = False
    unit: str = ""

    def met(self) -> bool | None:
        """Whether the target is met; None without one."""
        if self.target is None:
            return None
        if self.value is None:
            return False
        return self.value <= self.target if self.at_most else self.value >= self.target

    def cells(self) -> list[str]:
        """As text."""
        target = "" if self.target is None else f"{'≤' if self.at_most else '≥'} {self.target:g} {self.unit}".rstrip()
        return [
            self.name,
            self.figure,
            self.beside,
            spell(self.ratio),
            target,
            {None: "", True: "yes"}.get(self.met(), "no"),
        ]


def spell(ratio: dict | float | None) -> str:
    """Median with the smallest and the largest value."""
    if ratio is None:
        return ""
    if not isinstance(ratio, dict):
        return f"{ratio:.3g}"
    return f"{ratio['median']:.3g} ({ratio['min']:.3g} to {ratio['max']:.3g})"


def middle(values: dict) -> str:
    """Median with thousands separated."""
    return f"{values['median']:,.0f}"


def camera(result: dict) -> Iterator[Row]:
    rates = result["frames_per_second"]
    name, figure = f"camera, fleet of {result['devices']}", f"{middle(rates['fleet'])} frames/s"
    for other, label in (("stock", "stock DMControlWrapper"), ("bare", "bare loop over whole pictures")):
        ratio = result[f"fleet_over_{other}"]
        yield Row(name, figure, f"{label}: {middle(rates[other])}", ratio, ratio["target"], ratio["median"])


def collection(result: dict) -> Iterator[Row]:
    rates = result["frames_per_second"]
    seconds, start = result["seconds"]["median"], result["of_which_start_seconds"]["median"]
    figure = f"{seconds:.1f} s, {start:.1f} s of them to start; {middle(rates['collection'])} frames/s"
    name = f"collection of {result['trajectories']} trajectories"
    yield Row(name, figure, f"bare render loop: {middle(rates['bare'])}", result["collection_over_bare"])


def training_step(result: dict) -> Iterator[Row]:
    rates, ratio = result["samples_per_second"], result["training_over_resident"]
    name, figure = f"training, {result['recipe']}, {result['device']}", f"{middle(rates['training'])} samples/s"
    yield Row(
        name, figure, f"resident random batch: {middle(rates['resident'])}", ratio, ratio["target"], ratio["median"]
    )
    floor = (
        f"{result['gigaflop_per_step']:.0f} GFLOP a step at {result['computes_in']}'s "
        f"{result['gemm_gigaflop_per_second']:,.0f} GFLOP/s"
    )
    yield Row(name, figure, floor, result["training_over_flop_floor"])
    peak, limit = result["peak_memory_gib"], result["peak_memory_target_gib"]
    yield Row(f"{name}, memory", f"{peak:.2f} GiB", target=limit, value=peak, at_most=True, unit="GiB")


def peers(result: dict) -> Iterator[Row]:
    part = result["training"]
    if "left_out" in part:
        yield Row("training beside lightly", "left out", part["left_out"])
    else:
        rates = part["samples_per_second"]
        figure = f"{middle(rates['ours'])} samples/s"
        yield Row(
            f"training, {part['recipe']}",
            figure,
            f"{part['peer']}: {middle(rates['lightly'])}",
            part["ours_over_lightly"],
        )
    part = result["environment"]
    if "left_out" in part:
        yield Row("environment beside stable-worldmodel", "left out", part["left_out"])
        return
    rates = part["frames_per_second"]
    for other, size in (("swm", "64 x 128"), ("swm_224", "224 x 224")):
        yield Row(
            f"environment, fleet of {part['devices']}",
            f"{middle(rates['fleet'])} frames/s",
            f"{part['peer']} at {size}: {middle(rates[other])}",
            part[f"fleet_over_{other}"],
        )


def quality(result: dict) -> Iterator[Row]:
    target = result["target"]
    best = max(result["runs"], key=lambda run: run["normalized_score"])
    runs = len(result["runs"])
    reached = f"best of {runs} run{'s' * (runs > 1)}: {best['normalized_score']:.3f} ± {best['interval_95']:.3f}"
    for score, seconds in result["seconds_to_score"].items():
        yield Row(
            f"empty folder to a score of {score}, {result['accelerator']}",
            "not reached" if seconds is None else f"{seconds:.0f} s",
            reached,
            target=target["seconds"] if float(score) == target["score"] else None,
            value=seconds,
            at_most=True,
            unit="s",
        )


def network(result: dict) -> Iterator[Row]:
    rates = result["device_slots_per_second"]
    figure = f"{rates['channel_aware']['median'] / 1e6:.1f} million device-slots/s"
    limit = result["threads"] * result["channel_aware_on_one_thread"]["1000"]["ours"]["median"]
    yield Row(
        f"network alone, I = 1000, {result['threads']} threads",
        figure,
        f"{result['threads']} times one thread: {limit / 1e6:.1f}",
        rates["channel_aware"]["median"] / limit,
    )
    for devices, row in result["channel_aware_on_one_thread"].items():
        figure = f"{row['ours']['median'] / 1e6:.1f} million device-slots/s"
        other = f"plain torch loop: {row['plain_loop']['median'] / 1e6:.1f}"
        yield Row(f"network alone, I = {devices}, one thread", figure, other, row["ours_over_plain_loop"])
    if "left_out" in result["sionna"]:
        yield Row("38.901 topologies beside Sionna", "left out", result["sionna"]["left_out"])
    for name, row in {} if "left_out" in result["sionna"] else result["sionna"].items():
        devices = row["devices_per_second"]
        figure, other = f"{devices['ours']:,.0f} devices/s", f"Sionna: {devices['sionna']:,.0f}"
        yield Row(f"38.901 topologies, InF-{name}", figure, other, row["ours_over_sionna"])


def radio(result: dict) -> Iterator[Row]:
    part = result["network"]
    if "left_out" in part:
        yield Row("network alone beside an older commit", "left out", part["left_out"])
    else:
        figure, ratio = f"{part['ours']['median'] / 1e6:.1f} million device-slots/s", part["ours_over_other"]
        other = f"commit {part['other_commit']}: {part['other']['median'] / 1e6:.1f}"
        yield Row("network alone, I = 1000, one thread", figure, other, ratio, ratio["target"], ratio["median"])
    for row in result["fleet"]:
        rates = row["device_steps_per_second"]
        yield Row(
            f"fleet by urgency, all devices drawn and encoded, I = {row['devices']}",
            f"{middle(rates['urgency'])} device-steps/s",
            f"channel_aware, what is sent: {middle(rates['channel_aware'])}",
            row["urgency_over_channel_aware"],
        )


def fleet(result: dict) -> Iterator[Row]:
    peak = result["gemm_gigaflop_per_second"]["median"]
    for row in result["fleet"]:
        name = f"fleet, drawn and encoded, I = {row['devices']}, {result['threads']} threads"
        figure = f"{middle(row['device_steps_per_second'])} device-steps/s"
        alone = f"drawing and encoding alone: {middle(row['drawing_and_encoding_alone_per_second'])}"
        yield Row(name, figure, alone, row["fleet_over_alone"])
        floor = f"the encoder's {result['encoder_megaflop']:.1f} MFLOP each at float32's {peak:.0f} GFLOP/s"
        yield Row(name, figure, floor, row["fleet_over_encoder_floor"])
    row = result["encoding"]
    single = row["one_by_one_per_second"]
    floor = f"{result['encoder_megaflop']:.1f} MFLOP each at float32's {peak:.0f} GFLOP/s"
    for way, label in (
        ("batched", "float32"),
        ("bfloat16", f"bfloat16, cosine ≥ {row['least_cosine_of_bfloat16']:.5f}"),
    ):
        name = f"encoding a fleet of {row['devices']} at once, {label}, {result['threads']} threads"
        figure = f"{middle(row[way]['per_second'])} embeddings/s"
        ratio, share = row[way]["over_one_by_one"], row[way]["over_float32_floor"]
        # what the program does is judged: by three times one by one or, if it is there, by the limit of the FLOPs
        target = row["target_over_one_by_one"] if way == "batched" else None
        value = target if share["median"] >= row["target_over_floor"] else ratio["median"]
        yield Row(name, figure, f"one by one: {middle(single)}", ratio, target, value)
        yield Row(name, figure, floor, share)


def latency(result: dict) -> Iterator[Row]:
    for name, row in {"device: frames to payload": result["device"], **result["controller"]}.items():
        took = row["milliseconds"]["onnx"]["median"]
        floor = f"floor: {row['floor_milliseconds']['median']:.3f} ms of {row['megaflop']:.1f} MFLOP"
        yield Row(
            f"controller: predict and act, I = {name}" if name.isdigit() else name,
            f"{took:.2f} ms on one core",
            floor,
            row["onnx_over_floor"],
            row.get("target_milliseconds"),
            took,
            at_most=True,
            unit="ms",
        )
    payload, frames = result["payload_bits"], result["frame_bits"]
    yield Row("device: payload", f"{payload / 8:,.0f} bytes", f"its frames: {frames / 8:,.0f}", payload / frames)
    peak, empty = (result["device_memory"][key] for key in ("peak_mib", "of_which_python_and_onnx_runtime_mib"))
    yield Row("device: memory", f"{peak:.0f} MiB", f"Python and ONNX Runtime alone: {empty:.0f}", peak / empty)


def loading(result: dict) -> Iterator[Row]:
    name, seconds = max(result["seconds_to_load"].items(), key=lambda entry: entry[1]["median"])
    took = seconds["median"]
    label = f"loading the slowest of {len(result['seconds_to_load'])} zoo entries, {name}"
    yield Row(label, f"{took:.2f} s", target=result["limit_s"], value=took, at_most=True, unit="s")


def memory(result: dict) -> Iterator[Row]:
    growth = result["growth_percent"]
    yield Row(
        f"memory growth in per cent, {result['devices']:,} devices for {result['slots']:,} slots",
        f"{growth:.3g}",
        f"{result['resident_mb_after_a_tenth']} MB after a tenth",
        target=MEMORY_GROWTH_PERCENT,
        value=growth,
        at_most=True,
        unit="%",
    )


def commits(result: dict) -> Iterator[Row]:
    cpu = result["machine"]["ATEN_CPU_CAPABILITY"]
    for name, unit in (("camera", "frames"), ("network", "device-slots"), ("training", "samples")):
        rates = result[name]
        other = f"commit {OLD}: {middle(rates['old'])}"
        yield Row(f"{name} beside version 0.1, {cpu}", f"{middle(rates['new'])} {unit}/s", other, rates["new_over_old"])


PARTS: dict[str, Callable[[dict], Iterator[Row]]] = {
    part.__name__: part
    for part in (
        camera, collection, training_step, peers, quality, network, radio, fleet, latency, loading, memory, commits
    )
}  # fmt: skip
HEAD = ("what", "figure", "peer or limit", "ratio: median (range)", "target", "met", "commit")
ABOVE = """# Benchmarks

Made by `make bench`, but for the files `radio` and `commits`, which compare with an older checkout. A row is as old as
its commit: version 0.2 begins on 2026-11-25, and what was measured before is version 0.1's. What is of a model is of
the entry as it was then. The list below the table has the date, the machine and the command of each file.

"""


def table(folder: Path) -> str:
    """The table in Markdown, and below it where the figures come from."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    origins, absent = [], []
    for name, part in PARTS.items():
        path = folder / f"{name}.json"
        if not path.is_file():
            absent.append(path.name)
            continue
        result = json.loads(path.read_text())
        made, machine = result["made_by"], result["machine"]
        for row in part(result):
            lines.append("| " + " | ".join([*row.cells(), made["commit"][:7]]) + " |")
        origins.append(
            f"- {path.name}: {made['commit']}, {made['date']}, {machine['cores']} cores of {machine['processor']}, "
            f"load average {machine['load_average']} at the end; `python tests/benchmarks/{made['command']}`"
        )
    if absent:
        origins.append(f"- not measured: {', '.join(absent)}")
    return "\n".join([*lines, "", *origins, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", default="docs/results", help="folder of the JSON files")
    parser.add_argument("--output", help="default: benchmarks.md in that folder")
    options = parser.parse_args()
    text = table(Path(options.results))
    write_text(options.output or Path(options.results) / "benchmarks.md", ABOVE + text)
    print(text)


if __name__ == "__main__":
    main()
