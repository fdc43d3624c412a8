"""The README's animation: ``python -m tsjepa.paper.film``.

One fleet twice on the same radio, with the same plants and channels: embeddings, prediction and channel-aware
scheduling beside raw frames and round-robin. Every tile is a device, in slow motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tsjepa.envs import Radio
from tsjepa.evaluation import rollouts
from tsjepa.evaluation.fleet_film import has_fallen
from tsjepa.evaluation.metrics import Run
from tsjepa.evaluation.rollouts import Loop
from tsjepa.paper.rows import SAMPLING_INTERVAL, load, plant_of
from tsjepa.plants.cartpole import FAILURE_POSITION
from tsjepa.support.files import whole

WIDTH, MARGIN, GAP = 800, 12, 24
HEAD, FOOT = 92, 46
TILE_ASPECT = 0.92  # height over width
SCALE = 2  # drawn so much larger and averaged down
COLORS = 96  # of the GIF's palette
STALE_AGE = 25  # slots; a tile is fully shaded from here on
# RGB
PAPER, INK, MUTED, LINE = (255, 255, 255), (38, 42, 48), (120, 126, 134), (222, 225, 229)
FRESH, STALE, FALLEN = (247, 249, 250), (253, 214, 160), (232, 168, 160)
SENT, LOST, IN_BOX, DOWN = (0, 114, 178), (213, 94, 0), (0, 138, 98), (170, 60, 45)


@dataclass
class Side:
    """One half of the picture: what it is called, what it sends, and its run."""

    title: str
    sends: str
    run: Run


def film(
    output: str = "docs/pictures",
    num_devices: int = 48,
    ours: str = "tsjepa-cartpole",
    theirs: str = "supervised-cartpole-k2",
    bandwidth_mhz: float = 8.0,
    slots: int = 150,
    every: int = 2,
    frame_ms: int = 110,
    seed: int = 0,
) -> None:
    """Writes fleet.gif.

    Args:
        output: folder.
        num_devices: of either fleet.
        ours: model that sends int8 embeddings.
        theirs: model whose devices send raw frames, its command held between updates.
        bandwidth_mhz: of the uplink, whose resource units go to whom the scheduler picks.
        slots: length of the episode, 20 ms each.
        every: slots from picture to picture.
        frame_ms: how long a picture is shown.
        seed: of plants and channels.
    """
    from PIL import Image

    sides = [
        fleet("TS-JEPA, channel-aware", ours, "int8", "channel_aware", num_devices, bandwidth_mhz, slots, seed),
        fleet("Raw frames, round-robin", theirs, "raw", "round_robin", num_devices, bandwidth_mhz, slots, seed),
    ]
    pictures = [Image.fromarray(picture(sides, slot, bandwidth_mhz)) for slot in range(0, slots, every)]
    # one palette for all, so that what stays the same costs nothing, and of all colours however small their areas
    shown = np.concatenate([np.asarray(image) for image in pictures[::10]])
    palette = Image.fromarray(shown).quantize(COLORS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    pictures = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in pictures]
    path = Path(output) / "fleet.gif"
    path.parent.mkdir(parents=True, exist_ok=True)
    held = [frame_ms] * (len(pictures) - 1) + [1500]  # on the last picture, before it begins again
    with whole(path, ".gif") as partial:
        pictures[0].save(partial, save_all=True, append_images=pictures[1:], duration=held, loop=0, optimize=True)
    print(f"{path}: {len(pictures)} pictures, {path.stat().st_size / 1e6:.1f} MB.")


def fleet(title, entry, codec_name, scheduler, num_devices, bandwidth_mhz, slots, seed) -> Side:
    """Runs one of the two fleets; see :func:`film`."""
    model = load(entry)
    radio = Radio(resource_blocks=None, bandwidth_mhz=bandwidth_mhz, codec=codec_name)
    between = "predict" if codec_name == "int8" else "hold"
    loop = Loop(plant_of(SAMPLING_INTERVAL), model, scheduler, num_devices, slots, radio, between=between)
    run = rollouts.run(loop, seed)
    bits = int(run.payload_bits.max())
    return Side(title, f"{bits / 1000:.0f} kbit an update" if bits >= 10_000 else f"{bits} bit an update", run)


def picture(sides: list[Side], slot: int, bandwidth_mhz: float) -> np.ndarray:
    """Both fleets in one slot, uint8 RGB [H, WIDTH, 3]."""
    import cv2

    count = sides[0].run.age.shape[1]
    panel = (WIDTH - 2 * MARGIN - GAP) / 2
    columns = math.ceil(math.sqrt(4 / 3 * count))
    tile = panel / columns
    height = round(HEAD + tile * TILE_ASPECT * math.ceil(count / columns) + FOOT)
    canvas = np.full((SCALE * height, SCALE * WIDTH, 3), 255, np.uint8)
    for index, side in enumerate(sides):
        left = MARGIN + index * (panel + GAP)
        header(canvas, side, slot, left, panel)
        fallen = has_fallen(side.run, slot)
        for device in range(count):
            x, y = left + device % columns * tile, HEAD + device // columns * tile * TILE_ASPECT
            device_tile(canvas, side.run, slot, device, bool(fallen[device]), x, y, tile)
    footer(canvas, slot, height, bandwidth_mhz)
    return cv2.resize(canvas, (WIDTH, height), interpolation=cv2.INTER_AREA)


def header(canvas: np.ndarray, side: Side, slot: int, left: float, width: float) -> None:
    """Title, payload, and how many devices stand in the box, as a number and as a bar."""
    run = side.run
    count = run.age.shape[1]
    good = int(inside(run, slot).sum())
    fallen = int(has_fallen(run, slot).sum())
    sending = int(run.scheduled[slot].sum())
    write(canvas, side.title, left, 22, 0.62, INK, 2)
    write(canvas, f"{side.sends}   {sending} of {count} send", left, 42, 0.42, MUTED)
    write(canvas, f"{good}", left, 72, 0.85, IN_BOX, 2)
    offset = text_width(f"{good}", 0.85, 2) + 8
    write(canvas, "on target", left + offset, 72, 0.46, INK)
    right = f"{fallen} fallen   age {float(run.age[slot].double().mean()):.1f}"
    write(canvas, right, left + width - text_width(right, 0.46, 1), 72, 0.46, DOWN if fallen else INK)
    box(canvas, left, 79, width, 5, LINE)
    box(canvas, left, 79, width * good / count, 5, IN_BOX)
    if fallen:
        box(canvas, left + width * (1 - fallen / count), 79, width * fallen / count, 5, DOWN)


def device_tile(canvas, run: Run, slot: int, device: int, fallen: bool, x: float, y: float, size: float) -> None:
    """Cart and pole on a ground that darkens with age, framed while the device sends."""
    import cv2

    width, height, pad = size, size * TILE_ASPECT, 1.5
    staleness = min(1.0, (int(run.age[slot, device]) - 1) / (STALE_AGE - 1))
    ground = FALLEN if fallen else tuple(round(a + staleness * (b - a)) for a, b in zip(FRESH, STALE, strict=True))
    box(canvas, x + pad, y + pad, width - 2 * pad, height - 2 * pad, ground)
    if run.scheduled[slot, device]:
        color = SENT if run.delivered[slot, device] else LOST
        frame(canvas, x + pad + 0.5, y + pad + 0.5, width - 2 * pad - 1, height - 2 * pad - 1, color)
    position, angle = run.state[slot, device, :2].tolist()
    color = DOWN if fallen else IN_BOX if inside(run, slot)[device] else INK
    reach = (width / 2 - 9) / FAILURE_POSITION
    centre = x + width / 2 + max(-FAILURE_POSITION, min(FAILURE_POSITION, position)) * reach
    rail, length = y + height - 9, height - 18
    line(canvas, (x + 4, rail + 3), (x + width - 4, rail + 3), LINE if not fallen else MUTED, 1)
    top = (centre + length * math.sin(angle), rail - length * math.cos(angle))
    # a pole that has fallen would hang into the tile below
    top = (min(max(top[0], x + 3), x + width - 3), min(max(top[1], y + 3), y + height - 3))
    line(canvas, (centre, rail), top, color, 2)
    box(canvas, centre - 5, rail - 3, 10, 6, color)
    cv2.circle(canvas, at(*top), round(1.8 * SCALE), color, -1, cv2.LINE_AA)


def footer(canvas: np.ndarray, slot: int, height: int, bandwidth_mhz: float) -> None:
    """What the colours mean, and the time."""
    y, x = height - 17, MARGIN
    for label, color, framed in (
        ("sends", SENT, True),
        ("lost", LOST, True),
        ("not heard for long", STALE, False),
        ("on target", IN_BOX, False),
        ("fallen", FALLEN, False),
    ):
        if framed:
            frame(canvas, x + 0.5, y - 10, 11, 11, color)
        else:
            box(canvas, x, y - 10, 12, 12, color)
        write(canvas, label, x + 18, y, 0.42, INK)
        x += 18 + text_width(label, 0.42, 1) + 20
    time = f"one {bandwidth_mhz:g} MHz uplink   {0.02 * slot:.2f} s"
    write(
        canvas, time, WIDTH - MARGIN - text_width(f"one {bandwidth_mhz:g} MHz uplink   0.00 s", 0.42, 1), y, 0.42, INK
    )


def inside(run: Run, slot: int) -> np.ndarray:
    """[I] bool: which devices are in the box when the slot begins."""
    return plant_of(SAMPLING_INTERVAL).score(run.state[slot]).numpy()


def at(x: float, y: float) -> tuple[int, int]:
    """A place on the enlarged canvas."""
    return round(x * SCALE), round(y * SCALE)


def box(canvas: np.ndarray, x: float, y: float, width: float, height: float, color) -> None:
    """A filled rectangle."""
    (left, top), (right, bottom) = at(x, y), at(x + width, y + height)
    canvas[top:bottom, left:right] = color


def frame(canvas: np.ndarray, x: float, y: float, width: float, height: float, color) -> None:
    """The border of a rectangle, two pixels wide."""
    import cv2

    cv2.rectangle(canvas, at(x, y), at(x + width, y + height), color, 2 * SCALE)


def line(canvas: np.ndarray, start, end, color, width: int) -> None:
    """A smooth line."""
    import cv2

    cv2.line(canvas, at(*start), at(*end), color, width * SCALE, cv2.LINE_AA)


def write(canvas: np.ndarray, text: str, x: float, y: float, size: float, color, weight: int = 1) -> None:
    """Text with its baseline at y."""
    import cv2

    cv2.putText(canvas, text, at(x, y), cv2.FONT_HERSHEY_SIMPLEX, SCALE * size, color, SCALE * weight, cv2.LINE_AA)


def text_width(text: str, size: float, weight: int) -> float:
    """Pixels that a text takes."""
    import cv2

    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, SCALE * size, SCALE * weight)[0][0] / SCALE


if __name__ == "__main__":
    from jsonargparse import auto_cli

    auto_cli(film)
