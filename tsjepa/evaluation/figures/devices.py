"""The largest fleet that keeps an acceptable score, by bisection over sizes a third of an octave apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache

import torch

from tsjepa.evaluation import fleet
from tsjepa.evaluation.closed_loop import run
from tsjepa.evaluation.figures.loops import load, stacks
from tsjepa.evaluation.fleet_codecs import FRAME_CODECS, fitted_codec
from tsjepa.evaluation.fleet_search import crossing, mean
from tsjepa.evaluation.fleet_settings import Plants, Radio
from tsjepa.evaluation.metrics import normalized_score
from tsjepa.network import GilbertElliott, IidLoss
from tsjepa.network.codecs import make_codec, payload_bits

ACCEPTABLE = 0.74  # normalised score (the paper's [0.74, 1.0])
PER_OCTAVE = 3
RADIO_FIELDS = ("resource_blocks", "bandwidth_mhz", "snr_target_db", "csi", "csi_delay", "max_doppler_hz")
FULL_BANDWIDTH_MHZ = 20.0
RESERVED_OVER_LARGEST = 1.1  # what a device reserves for a picture, over the largest that the expert's loops show


def device_rows(point: dict) -> list[dict]:
    """The largest fleet of a point.

    Args:
        point: ``model`` (None: the expert on the true state, its command held), ``codec``, ``quality``, ``scheduler``,
            ``smallest`` and ``largest`` (sizes between which it is looked for), ``seeds``, ``slots``,
            ``process_noise_std``, ``snr_threshold_db``; where given, ``between`` ("hold": the model's command is held
            instead of predicted), ``loss`` (probability of an erasure), ``burst_slots`` (mean length of a run of them),
            ``also_at`` (a size that is measured whatever the search tries), and the fields of :class:`Radio` in
            RADIO_FIELDS.

    Returns:
        A row for each seed and size that was tried, with ``num_devices``, ``score``, ``mean_age``, ``failed``,
        ``utilisation``; and a row a seed with ``devices``, where its score crosses the acceptable one, scaled to 20 MHz
        where the point has a ``bandwidth_mhz``, and ``bound``: "exact", "at least" or "at most".
    """
    model = None if point["model"] is None else load(point["model"])
    if point.get("between") == "hold":
        model = without_predictor(model)
    history = 2 if model is None else model.frame_history
    plants = Plants(point["slots"], process_noise_std=point["process_noise_std"], frame_history=history)
    codec = codec_of(point, plants, model)
    radio = radio_of(point, plants, codec, model)
    optimal = optimal_scores(plants, point["seeds"], point["largest"])
    if not optimal[:, : point["smallest"]].sum(1).all():
        raise ValueError(
            f"For some seed none of {point['smallest']} devices is in the box within {point['slots']} slots even with "
            "perfect feedback, so scores cannot be normalised; raise smallest or slots."
        )
    rows = []

    def scores(size: int) -> list[float]:
        new = [measure(size, seed, point["scheduler"], plants, radio, codec, model, optimal) for seed in seeds]
        rows.extend(new)
        return [row["score"] for row in new]

    seeds = range(point["seeds"])
    curve, bound = bisect(scores, sizes_between(point["smallest"], point["largest"]))
    if point.get("also_at") not in (None, *curve):
        scores(point["also_at"])
    scale = FULL_BANDWIDTH_MHZ / point.get("bandwidth_mhz", FULL_BANDWIDTH_MHZ)
    for seed in seeds:
        found = crossing({size: values[seed] for size, values in curve.items()}, ACCEPTABLE)
        rows.append({"seed": seed, "devices": scale * found, "bound": bound})
    return rows


def without_predictor(model):
    """The same controller, whose last command is held between updates."""
    held = copy(model)
    held.architecture = replace(model.architecture, has_predictor=False)
    return held


def measure(size: int, seed: int, scheduler: str, plants: Plants, radio: Radio, codec, model, optimal) -> dict:
    """One fleet, one seed."""
    outcome = fleet.run_fleet(size, scheduler, seed, plants, radio, codec, fleet.HOLD if model is None else model)
    return {
        "seed": seed,
        "num_devices": size,
        "score": normalized_score(outcome.loop.raw_score(), optimal[seed, :size]),
        "mean_age": float(outcome.age.double().mean()),
        "failed": float(outcome.loop.failed().float().mean()),
        "utilisation": outcome.utilisation(),
        "bits_per_device_and_slot": float(outcome.payload_bits.double().mean()),
    }


def sizes_between(smallest: int, largest: int) -> list[int]:
    """Whole numbers, the first ``smallest`` and the last ``largest``, about a third of an octave apart."""
    if not 1 <= smallest < largest:
        raise ValueError(f"smallest is {smallest} and largest {largest}; give 1 <= smallest < largest.")
    ratio, sizes = 2 ** (1 / PER_OCTAVE), [smallest]
    while sizes[-1] * ratio < largest:
        sizes.append(max(sizes[-1] + 1, round(sizes[-1] * ratio)))
    return [*(size for size in sizes if size < largest), largest]


def bisect(scores: Callable[[int], list[float]], sizes: Sequence[int]) -> tuple[dict[int, list[float]], str]:
    """Scores per seed at the sizes that lead to where their mean crosses the acceptable one.

    Returns:
        By size, ascending; and whether the crossing lies between two of them ("exact"), at or beyond the last ("at
        least"), or before the first ("at most").
    """
    curve: dict[int, list[float]] = {}
    good, bad = -1, len(sizes)
    while bad - good > 1:
        middle = (good + bad) // 2
        curve[sizes[middle]] = scores(sizes[middle])
        if mean(curve[sizes[middle]]) >= ACCEPTABLE:
            good = middle
        else:
            bad = middle
    bound = "at most" if good < 0 else "at least" if bad == len(sizes) else "exact"
    return dict(sorted(curve.items())), bound


@lru_cache(maxsize=8)
def optimal_scores(plants: Plants, seeds: int, count: int) -> torch.Tensor:
    """See :func:`tsjepa.evaluation.fleet.optimal_scores`; kept for the next point."""
    return fleet.optimal_scores(plants, seeds, count)[1]


def codec_of(point: dict, plants: Plants, model):
    """The codec of an update, with the quality that the point asks for."""
    if point["codec"] in FRAME_CODECS:
        stack = model.architecture.frame_stack
        return make_codec(point["codec"], quality=point.get("quality") or 50, frame_stack=stack)
    return fitted_codec(point["codec"], plants, model)


def radio_of(point: dict, plants: Plants, codec, model) -> Radio:
    """The uplink of a point."""
    loss, burst = point.get("loss", 0.0), point.get("burst_slots")
    if burst is not None:
        # a run of erasures lasts burst_slots on average, and erased slots are the given share
        process = GilbertElliott(good_to_bad=loss / (1 - loss) / burst, bad_to_good=1 / burst)
    else:
        process = IidLoss(loss) if loss else None
    varies = point["codec"] in FRAME_CODECS and point["codec"] != "raw"
    given = {name: point[name] for name in RADIO_FIELDS if name in point}
    return Radio(
        **{"resource_blocks": None} | given,
        codec=point["codec"],
        payload_bits=reserved_bits(plants, codec, model) if varies else None,
        snr_threshold_db=point["snr_threshold_db"],
        loss=process,
    )


def reserved_bits(plants: Plants, codec, model, count: int = 10) -> int:
    """Bits to reserve for a picture: the largest along loops that the expert closes, and a tenth more."""
    from tsjepa.envs import Renderer
    from tsjepa.envs.expert import Expert
    from tsjepa.evaluation.fleet_codecs import CALIBRATION_SEED

    renderer, expert, largest = Renderer(), Expert(plants.sampling_interval), 0

    def watched(slot: int, observation) -> torch.Tensor:
        nonlocal largest
        if slot % 10 == 0:
            packets = codec.encode(stacks(model, renderer, observation))
            largest = max(largest, int(payload_bits(packets).max()))
        return expert(observation["state"])

    run(plants.starts(CALIBRATION_SEED, count), watched)
    return int(RESERVED_OVER_LARGEST * largest)
