"""Bits against score: what a slot costs on the air, and how well the cart-pole is held (ours)."""

from __future__ import annotations

from pathlib import Path

from tsjepa.paper import plots
from tsjepa.paper.claims import Verdict, judge
from tsjepa.paper.grids import grid
from tsjepa.paper.rows import loop_rows

TITLE = "Bits against score"
CAPTION = (
    "One device, nothing lost. Embeddings of every dimension as fp32, int8 and int4; frames as raw pixels, PNG, JPEG, "
    "WebP and H.264 into the supervised controller and into TS-JEPA's encoder at the far end; the true state into the "
    "expert as the floor. A stack is one picture with all the frames that a controller needs, so that every update "
    "stands by itself; a stream sends the newest frame alone and needs an update in every slot. H.264 is x264 without "
    "delay, one key frame, a stream a device. Bits are those of the real packets, per slot; error bars are 95 % "
    "intervals over seeds."
)
MEASURES = ("score", "bits_per_slot")
ENOUGH = 0.9  # normalised score at which the bits are compared
STILLS, RAW = 5.0, 500.0  # times the bits of an embedding that are expected of still pictures and of raw frames
STYLES = {  # by what is sent: name in the plot, colour, marker
    "state": ("true state", plots.PALETTE[6], "*"),
    "embedding": ("embedding", plots.PALETTE[0], "o"),
    "stack": ("stack of frames", plots.PALETTE[1], "s"),
    "stream": ("frames one by one", plots.PALETTE[2], "D"),
    "video": ("H.264", plots.PALETTE[3], "^"),
}
SUPERVISED = "supervised-cartpole-k2"


def points(states: list[dict], embeddings: list[dict], frames: list[dict], sizes: dict) -> list[dict]:
    """The sweep; fields of an item that are lists stand for all combinations.

    Args:
        states: ``codec`` of the true state.
        embeddings: ``model``, ``codec`` and ``update_every``.
        frames: ``model``, ``sends``, ``codec`` and ``quality``.
        sizes: ``seeds``, ``starts``, ``slots``, ``process_noise_std``.
    """
    common = [
        *({"model": None, "sends": "state", "update_every": 1, "between": "hold"} | item for item in states),
        *({"sends": "embedding", "between": "predict"} | item for item in embeddings),
        *({"update_every": 1, "between": "hold"} | item for item in frames),
    ]
    return [point for item in common for point in grid(item | sizes)]


evaluate = loop_rows


def draw(records: list[dict], path: str | Path) -> None:
    """Score over bits per slot, a marker a point; hollow where the frames go into TS-JEPA, or slots are left out."""
    figure, (axis,) = plots.canvas(width=12, height=6.5)
    named = set()
    for record in records:
        point = record["point"]
        name, color, marker = STYLES[point["sends"]]
        hollow = point["update_every"] > 1 or (point["sends"] in ("stack", "stream", "video") and not supervised(point))
        name += "" if not hollow else " into TS-JEPA" if point["update_every"] == 1 else ", slots left out"
        bits = plots.mean(record["rows"], "bits_per_slot")
        score, half = plots.spread(record["rows"], "score")
        axis.errorbar(
            bits,
            score,
            half,
            color=color,
            marker=marker,
            markerfacecolor="white" if hollow else color,
            markersize=5,
            elinewidth=0.8,
            linestyle="",
            label=None if name in named else name,
        )
        named.add(name)
        axis.annotate(
            short_name(point),
            (bits, score),
            xytext=(2, 4),
            textcoords="offset points",
            fontsize=6,
            color=color,
            rotation=60,
        )
    axis.axhline(ENOUGH, color="black", linewidth=0.8, linestyle=":")
    axis.set(xlabel="mean payload (bits per slot)", ylabel=plots.SCORE, xscale="log")
    plots.legend(figure, [axis])
    plots.save(figure, path, "How few bits keep one cart-pole up?")


def supervised(point: dict) -> bool:
    """Whether frames go into the supervised controller."""
    return point["model"] == SUPERVISED


def short_name(point: dict) -> str:
    """Codec, quality and period of a point, with the dimension where it is in the model's name."""
    dimension = point["model"].rpartition("-")[2] if point["sends"] == "embedding" and "-d" in point["model"] else ""
    quality = "" if point.get("quality") is None else f" {point['quality']}"
    codec = "crf" if point["sends"] == "video" else point["codec"]
    every = "" if point["update_every"] == 1 else f", every {point['update_every']}"
    return f"{dimension} {codec}{quality}{every}".strip()


def cheapest(records: list[dict], *sends: str, codec: str | None = None) -> dict | None:
    """The record with the fewest bits per slot among those that send so and score enough, or None."""
    good = [
        record
        for record in records
        if record["point"]["sends"] in sends
        and codec in (None, record["point"]["codec"])
        and plots.mean(record["rows"], "score") >= ENOUGH
    ]
    return min(good, key=lambda record: plots.mean(record["rows"], "bits_per_slot"), default=None)


def verdicts(records: list[dict]) -> dict[str, Verdict]:
    """Bits of the cheapest setting of each kind that scores 0.9."""
    every_slot = [record for record in records if record["point"]["update_every"] == 1]
    stills = [record for record in every_slot if record["point"]["codec"] != "raw"]
    best = {
        "embedding": cheapest(every_slot, "embedding"),
        "still picture": cheapest(stills, "stack", "stream"),
        "raw frame": cheapest(every_slot, "stack", "stream", codec="raw"),
        "H.264": cheapest(every_slot, "video"),
        "embedding, with slots left out": cheapest(records, "embedding"),
    }
    if not {"embedding", "stream"} <= {record["point"]["sends"] for record in records}:
        return {}
    best = {name: record for name, record in best.items() if record}
    bits = {name: plots.mean(record["rows"], "bits_per_slot") for name, record in best.items()}
    ours = f"fewest bits per slot at a score of {ENOUGH}: " + ", ".join(
        f"{name} {bits[name]:.0f} ({short_name(record['point'])})" for name, record in best.items()
    )
    if not {"embedding", "still picture", "raw frame"} <= set(bits):
        lacking = [name for name in ("embedding", "still picture", "raw frame") if name not in bits]
        missing = judge(False, ours, f"no {' and no '.join(lacking)} reaches that score")
        return {"fewer_bits": missing, "goal_bits": missing}
    still, raw = (bits[name] / bits["embedding"] for name in ("still picture", "raw frame"))
    video = bits.get("H.264", float("inf")) / bits["embedding"]
    needed = {"still pictures": still, "raw frames": raw, "H.264": video}
    as_few = [f"{name} {times:.2f} times" for name, times in needed.items() if times <= 1]
    short = [
        f"{name} less than {goal:g} times"
        for name, goal in (("still pictures", STILLS), ("raw frames", RAW))
        if needed[name] < goal
    ]
    times = f"{ours}; still pictures {still:.1f} times, raw frames {raw:.0f} times, H.264 {video:.1f} times as many"
    return {
        "fewer_bits": judge(not as_few, times, f"{' and '.join(as_few)} the bits of an embedding", partly=raw > 1),
        "goal_bits": judge(
            not short, times, f"{' and '.join(short)} the bits of an embedding", partly=still > 1 and raw > 1
        ),
    }
