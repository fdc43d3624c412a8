"""The largest fleet that keeps an acceptable score, by bisection over sizes half an octave apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache

import torch

from tsjepa.envs.settings import Plants, Radio
from tsjepa.envs.update_codec import FRAME_CODECS, fitted_codec
from tsjepa.evaluation import fleet
from tsjepa.evaluation.closed_loop import run
from tsjepa.evaluation.fleet_search import mean
from tsjepa.evaluation.metrics import normalized_score
from tsjepa.paper.loops import Camera, load
from tsjepa.radio import GilbertElliott, IidLoss
from tsjepa.radio.codecs import make_codec, payload_bits

ACCEPTABLE = 0.74  # normalised score (the paper's [0.74, 1.0])
PER_OCTAVE = 2
STEEP = 0.1  # fall of the score from which on it is more than the noise of a few seeds
SLACK = 0.05  # score by which one seed may stay below the acceptable one for all to be tried
RADIO_FIELDS = ("resource_blocks", "bandwidth_mhz", "snr_target_db", "csi", "csi_delay", "max_doppler_hz")
FULL_BANDWIDTH_MHZ = 20.0
CALIBRATION_SEED = 10_000  # starts that no evaluation uses
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
        where the point has a ``bandwidth_mhz``, and ``bound``: "exact", "at least" or "at most". The sizes are tried
        with the first seed, those on either side of the crossing with all of them.
    """
    model = None if point["model"] is None else load(point["model"])
    if point.get("between") == "hold":
        model = without_predictor(model)
    history = 2 if model is None else model.frame_history
    plants = Plants(point["slots"], process_noise_std=point["process_noise_std"], frame_history=history)
    codec = codec_of(point, model)
    radio = radio_of(point, plants, codec, model)
    optimal = optimal_scores(plants, point["seeds"], point["largest"])
    if not optimal[:, : point["smallest"]].sum(1).all():
        raise ValueError(
            f"For some seed none of {point['smallest']} devices is in the box within {point['slots']} slots even with "
            "perfect feedback, so scores cannot be normalised; raise smallest or slots."
        )
    measured: dict[tuple[int, int], dict] = {}

    def scores(size: int, seeds: int) -> list[float]:
        for seed in range(seeds):
            if (size, seed) not in measured:
                measured[size, seed] = measure(size, seed, point["scheduler"], plants, radio, codec, model, optimal)
        return [measured[size, seed]["score"] for seed in range(seeds)]

    curve, bound = bracket(scores, sizes_between(point["smallest"], point["largest"]), point["seeds"])
    if point.get("also_at"):
        scores(point["also_at"], point["seeds"])
    scale = FULL_BANDWIDTH_MHZ / point.get("bandwidth_mhz", FULL_BANDWIDTH_MHZ)
    found = [{"seed": seed, "devices": scale * size, "bound": bound} for seed, size in enumerate(crossings(curve))]
    return [*measured.values(), *found]


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
    """Whole numbers, the first ``smallest`` and the last ``largest``, about half an octave apart."""
    if not 1 <= smallest < largest:
        raise ValueError(f"smallest is {smallest} and largest {largest}; give 1 <= smallest < largest.")
    steps = math.ceil(PER_OCTAVE * math.log2(largest / smallest))
    between = {round(smallest * 2 ** (step / PER_OCTAVE)) for step in range(steps)}
    return [*sorted(size for size in between if size < largest), largest]


def bracket(
    scores: Callable[[int, int], list[float]], sizes: Sequence[int], seeds: int
) -> tuple[dict[int, list[float]], str]:
    """Scores of all seeds at the two neighbouring sizes between which their mean crosses the acceptable one.

    Where the score hardly falls from the one to the other, also at the next size at which it has fallen.

    The first seed alone is bisected, with some slack, for small fleets are noisy and where fading is what costs score
    the curve is flat; all seeds are then tried from there downwards, until a size is acceptable.

    Args:
        scores: from a size and a number of seeds to the score of each; asked again it answers the same, for nothing.
        sizes: ascending.
        seeds: how many.

    Returns:
        By size, ascending; and whether the crossing lies between the first two ("exact"), beyond the last size ("at
        least"), or before the first ("at most"), where there is only that one.
    """
    good, bad = -1, len(sizes)
    while bad - good > 1:
        middle = (good + bad) // 2
        good, bad = (middle, bad) if scores(sizes[middle], 1)[0] >= ACCEPTABLE - SLACK else (good, middle)

    def acceptable(index: int) -> bool:
        return mean(scores(sizes[index], seeds)) >= ACCEPTABLE

    while good >= 0 and not acceptable(good):
        good, bad = good - 1, good
    while bad < len(sizes) and acceptable(bad):
        good, bad = bad, bad + 1
    bound = "at most" if good < 0 else "at least" if bad == len(sizes) else "exact"
    fallen = bad
    if bound == "exact":
        enough = mean(scores(sizes[good], seeds)) - STEEP
        while fallen + 1 < len(sizes) and mean(scores(sizes[fallen], seeds)) > enough:
            fallen += 1
    around = sorted({index for index in (good, bad, fallen) if 0 <= index < len(sizes)})
    return {sizes[index]: scores(sizes[index], seeds) for index in around}, bound


def crossings(curve: dict[int, list[float]]) -> list[float]:
    """Number of devices at which each seed's score crosses the acceptable one.

    The mean score falls in proportion to the logarithm of the size between the two sizes; a seed whose score lies above
    it where the mean crosses has its own crossing further on along the slope from the first to the last size. So no
    seed's crossing is cut off at the sizes that were tried.

    Args:
        curve: scores per seed at two or three sizes, the mean acceptable at the smallest one alone; with one size that
            is the answer for every seed.
    """
    if len(curve) == 1:
        ((size, values),) = curve.items()
        return [float(size)] * len(values)
    (good, above), (bad, below), *_ = sorted(curve.items())
    last, lowest = max(curve.items())
    share = (mean(above) - ACCEPTABLE) / (mean(above) - mean(below))
    slope = (mean(above) - mean(lowest)) / math.log2(last / good)
    there = [(1 - share) * high + share * low for high, low in zip(above, below, strict=True)]
    return [good * (bad / good) ** share * 2 ** ((score - ACCEPTABLE) / slope) for score in there]


@lru_cache(maxsize=8)
def optimal_scores(plants: Plants, seeds: int, count: int) -> torch.Tensor:
    """See :func:`tsjepa.evaluation.fleet.optimal_scores`; kept for the next point."""
    return fleet.optimal_scores(plants, seeds, count)[1]


def codec_of(point: dict, model):
    """The codec of an update, with the quality that the point asks for."""
    if point["codec"] in FRAME_CODECS:
        stack = model.frame_stack
        return make_codec(point["codec"], quality=point.get("quality") or 50, frame_stack=stack)
    return fitted_codec(point["codec"], model)


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
    from tsjepa.plants.expert import Expert

    camera, expert, largest = Camera(), Expert(plants.sampling_interval), 0

    def watched(slot: int, observation) -> torch.Tensor:
        nonlocal largest
        if slot % 10 == 0:
            packets = codec.encode(camera.stacks(model, slot, observation))
            largest = max(largest, int(payload_bits(packets).max()))
        return expert(observation["state"])

    run(plants.starts(CALIBRATION_SEED, count), watched)
    return int(RESERVED_OVER_LARGEST * largest)
