"""The README's animation: ``python -m tsjepa.evaluation.figures.film``.

One fleet twice on the same radio, with the same plants and channels: embeddings, prediction and channel-aware
scheduling beside raw frames and round-robin.
"""

from __future__ import annotations

from pathlib import Path

from tsjepa.evaluation.figures.loops import load
from tsjepa.evaluation.fleet import run_fleet
from tsjepa.evaluation.fleet_codecs import fitted_codec
from tsjepa.evaluation.fleet_film import fleet_film
from tsjepa.evaluation.fleet_settings import Plants, Radio


def film(
    output: str = "docs/pictures",
    num_devices: int = 40,
    ours: str = "tsjepa-cartpole",
    theirs: str = "supervised-cartpole-k2",
    bandwidth_mhz: float = 20.0,
    slots: int = 150,
    seed: int = 0,
) -> None:
    """Writes fleet.mp4 and fleet.gif.

    Args:
        output: folder.
        num_devices: of either fleet.
        ours: model that sends int8 embeddings.
        theirs: model whose devices send raw frames.
        bandwidth_mhz: of the uplink, whose resource units go to whom the scheduler picks.
        slots: length of the film, 20 ms each.
        seed: of plants and channels.
    """
    runs = {}
    for name, entry, codec_name, scheduler in (
        ("embeddings, prediction, channel-aware", ours, "int8", "channel_aware"),
        ("raw frames, command held, round-robin", theirs, "raw", "round_robin"),
    ):
        model = load(entry)
        plants = Plants(slots=slots, frame_history=model.frame_history)
        radio = Radio(resource_blocks=None, bandwidth_mhz=bandwidth_mhz, codec=codec_name)
        codec = fitted_codec(codec_name, plants, model)
        runs[name] = run_fleet(num_devices, scheduler, seed, plants, radio, codec, model)
    Path(output).mkdir(parents=True, exist_ok=True)
    fleet_film(runs, Path(output))
    print(f"{output}/fleet.mp4 and {output}/fleet.gif.")


if __name__ == "__main__":
    from jsonargparse import auto_cli

    auto_cli(film)
