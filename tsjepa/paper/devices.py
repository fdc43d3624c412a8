"""The largest fleet that keeps an acceptable score, by bisection over sizes half an octave apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import fmean

from torch import Tensor

from tsjepa.envs import Radio
from tsjepa.envs.settings import FULL_BANDWIDTH_MHZ
from tsjepa.evaluation.metrics import normalized_score
from tsjepa.evaluation.rollouts import Loop, every, run
from tsjepa.evaluation.search import AT_LEAST, AT_MOST, EXACT
from tsjepa.paper import rows
from tsjepa.radio import GilbertElliott, IidLoss
from tsjepa.radio.codecs import FRAME_CODECS

ACCEPTABLE = 0.74  # normalised score (the paper's [0.74, 1.0])
PER_OCTAVE = 2
STEEP = 0.1  # fall of the score from which on it is more than the noise of a few seeds
SLACK = 0.05  # score by which one seed may stay below the acceptable one for all to be tried
RADIO_FIELDS = ("resource_blocks", "bandwidth_mhz", "snr_target_db", "csi", "csi_delay", "max_doppler_hz")
CALIBRATION_SEED = 10_000  # starts that no evaluation reaches
CALIBRATION_STARTS, CALIBRATION_PERIOD = 10, 10
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
        ``utilisation``; and those of :func:`found`. The sizes are tried with the first seed, those on either side of
        the crossing with all of them.
    """
    loop = loop_of(point)
    largest = Loop(loop.plant, loop.controller, num_devices=point["largest"], slots=loop.slots)
    optimal = rows.optimal_of(largest, point["seeds"])
    measured: dict[tuple[int, int], dict] = {}

    def scores(size: int, seeds: int) -> list[float]:
        for seed in range(seeds):
            if (size, seed) not in measured:
                measured[size, seed] = measure(loop, size, seed, optimal)
        return [measured[size, seed]["score"] for seed in range(seeds)]

    curve, bound = bracket(scores, sizes_between(point["smallest"], point["largest"]), point["seeds"])
    if point.get("also_at"):
        scores(point["also_at"], point["seeds"])
    return [*measured.values(), *found(curve, bound, per_full_bandwidth(loop))]


def loop_of(point: dict) -> Loop:
    """The loop of a point, of any number of devices."""
    model = None if point["model"] is None else rows.load(point["model"])
    interval = rows.SAMPLING_INTERVAL if model is None else model.spec.slot
    loop = Loop(
        rows.plant_of(interval, point["process_noise_std"]),
        model or "hold",
        point["scheduler"],
        slots=point["slots"],
        between=point.get("between"),
    )
    return replace(loop, radio=radio_of(point, loop))


def measure(loop: Loop, size: int, seed: int, optimal: Tensor) -> dict:
    """One fleet, one seed; ``optimal`` [seeds, I] are the normaliser's scores."""
    fleet = run(replace(loop, num_devices=size), seed)
    return {
        "seed": seed,
        "num_devices": size,
        "score": normalized_score(fleet.raw_score(), optimal[seed, :size]),
        "mean_age": float(fleet.age.double().mean()),
        "failed": float(fleet.failed().float().mean()),
        "utilisation": fleet.utilisation(),
        "bits_per_device_and_slot": float(fleet.payload_bits.double().mean()),
        "optimal_policy": loop.plant.normaliser,
    }


def per_full_bandwidth(loop: Loop) -> float:
    """How many times the resource units of a slot go into those of the full bandwidth; 1 where blocks are counted.

    Units, not megahertz: of 26.5 units a slot has 26.
    """
    if loop.radio.resource_blocks is not None:
        return 1.0
    slot = loop.plant.spec.slot
    return replace(loop.radio, bandwidth_mhz=FULL_BANDWIDTH_MHZ).units(slot) / loop.radio.units(slot)


def found(curve: dict[int, list[float]], bound: str, scale: float) -> list[dict]:
    """A row a seed with ``devices``, where its score crosses the acceptable one, times ``scale``.

    ``bound`` says whether the mean over seeds crosses between the sizes tried ("exact"), or beyond them ("at least") or
    before ("at most"); ``own_bound`` says the same of the seed's own scores. A seed that does not cross where the mean
    does has its number by extrapolation, see :func:`crossings`.

    Args:
        curve: scores of all seeds by size, as :func:`bracket` gives them.
        bound: likewise.
        scale: to the full bandwidth.
    """
    return [
        {"seed": seed, "devices": scale * size, "bound": bound, "own_bound": own_bound(curve, seed)}
        for seed, size in enumerate(crossings(curve))
    ]


def own_bound(curve: dict[int, list[float]], seed: int) -> str:
    """Whether a seed's own scores lie on both sides of the acceptable one, or all above it, or all below."""
    acceptable = [scores[seed] >= ACCEPTABLE for scores in curve.values()]
    return AT_LEAST if all(acceptable) else EXACT if any(acceptable) else AT_MOST


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
        scores: from a size and a number of seeds to the score of each; it is asked for the same one several times.
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
        return fmean(scores(sizes[index], seeds)) >= ACCEPTABLE

    while good >= 0 and not acceptable(good):
        good, bad = good - 1, good
    while bad < len(sizes) and acceptable(bad):
        good, bad = bad, bad + 1
    bound = AT_MOST if good < 0 else AT_LEAST if bad == len(sizes) else EXACT
    fallen = bad
    if bound == EXACT:
        enough = fmean(scores(sizes[good], seeds)) - STEEP
        while fallen + 1 < len(sizes) and fmean(scores(sizes[fallen], seeds)) > enough:
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
    share = (fmean(above) - ACCEPTABLE) / (fmean(above) - fmean(below))
    slope = (fmean(above) - fmean(lowest)) / math.log2(last / good)
    there = [(1 - share) * high + share * low for high, low in zip(above, below, strict=True)]
    return [good * (bad / good) ** share * 2 ** ((score - ACCEPTABLE) / slope) for score in there]


def radio_of(point: dict, loop: Loop) -> Radio:
    """The uplink of a point."""
    loss, burst, quality = point.get("loss", 0.0), point.get("burst_slots"), point.get("quality")
    if burst is not None:
        # a run of erasures lasts burst_slots on average, and erased slots are the given share
        process = GilbertElliott(good_to_bad=loss / (1 - loss) / burst, bad_to_good=1 / burst)
    else:
        process = IidLoss(loss) if loss else None
    given = {name: point[name] for name in RADIO_FIELDS if name in point}
    radio = Radio(
        **{"resource_blocks": None} | given,
        codec=point["codec"],
        quality=Radio.quality if quality is None else quality,
        snr_threshold_db=point["snr_threshold_db"],
        loss=process,
    )
    varies = point["codec"] in FRAME_CODECS and point["codec"] != "raw"
    return replace(radio, payload_bits=reserved_bits(loop, radio)) if varies else radio


def reserved_bits(loop: Loop, radio: Radio) -> int:
    """Bits to reserve for a picture: the largest along loops that the expert closes, and a tenth more."""
    alone = Radio(codec=radio.codec, quality=radio.quality, lossless=True)
    sending = replace(every(loop, CALIBRATION_PERIOD), radio=alone, num_devices=CALIBRATION_STARTS)
    return int(RESERVED_OVER_LARGEST * int(rows.driven(sending, CALIBRATION_SEED).payload_bits.max()))
