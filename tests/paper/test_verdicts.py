"""Verdicts on results whose answer is known."""

import math

import pytest

from tsjepa.paper import (
    bits,
    devices_encoding,
    devices_prediction,
    dimension,
    frame_change,
    one_device,
    schedulers,
    tsne,
)
from tsjepa.paper.claims import NOT, PARTLY, REPRODUCED, setbacks
from tsjepa.plants import Appearance, CartPole, describe_plant

SEEDS = range(3)


def record(point: dict, **measures: float) -> dict:
    """One recorded point whose seeds differ by a per cent."""
    rows = [{"seed": s} | {name: value * (1 + 0.01 * (s - 1)) for name, value in measures.items()} for s in SEEDS]
    return {"point": point, "rows": rows}


def fleets(counts: dict, **fields) -> list[dict]:
    """Records of device searches: counts by (label, scheduler)."""
    records = [
        record({"label": label, "scheduler": scheduler} | fields, devices=count)
        for (label, scheduler), count in counts.items()
    ]
    for entry in records:
        for row in entry["rows"]:
            row["bound"] = row["own_bound"] = "exact"
    return records


COUNTS = {
    ("TS-JEPA", "channel_aware"): 100,
    ("TS-JEPA", "round_robin"): 50,
    ("TS-JEPA", "opportunistic"): 40,
    ("supervised, WebP", "channel_aware"): 15,
    ("supervised, WebP", "round_robin"): 10,
    ("supervised, WebP", "opportunistic"): 8,
    ("supervised, raw frames", "channel_aware"): 2,
    ("supervised, raw frames", "round_robin"): 1,
}


def encoding(changed: dict) -> dict[str, str]:
    records = [entry for snr in (5, 20) for entry in fleets(COUNTS | changed, snr_target_db=snr)]
    return devices_encoding.verdicts(records)


def test_devices_as_the_paper_has_them_are_reproduced():
    found = encoding({})
    assert {name for name, verdict in found.items() if verdict.verdict == REPRODUCED} == {
        "devices_schedulers",
        "opportunistic_last",
        "scales",
        "goal_devices",
        "devices_controllers",
    }
    assert "10.0 (10.0 to 10.0) times supervised, WebP, round-robin" in found["goal_devices"].ours
    assert "2.5 (2.5 to 2.5) times its own opportunistic" in found["goal_devices"].ours
    assert "100 ± 2" in found["devices_schedulers"].ours


@pytest.mark.parametrize(
    ("changed", "name", "verdict", "said"),
    [
        (
            {("TS-JEPA", "opportunistic"): 100},
            "devices_schedulers",
            PARTLY,
            "not clearly ahead of its own opportunistic",
        ),
        ({("TS-JEPA", "opportunistic"): 100}, "goal_devices", PARTLY, "not clearly ahead of its own opportunistic"),
        ({("TS-JEPA", "opportunistic"): 60}, "opportunistic_last", NOT, "not clearly the fewest at 5 dB, 20 dB"),
        ({("supervised, WebP", "round_robin"): 25}, "goal_devices", PARTLY, "less than 5 times supervised, WebP"),
        ({("supervised, WebP", "round_robin"): 120}, "goal_devices", NOT, "less than 5 times supervised, WebP"),
        ({("supervised, WebP", "round_robin"): 120}, "scales", PARTLY, "supervised, WebP at 5 dB"),
        ({("supervised, WebP", "channel_aware"): 120}, "devices_controllers", PARTLY, "supervised, WebP at 20 dB"),
    ],
)
def test_devices_that_fall_short_are_not_hidden(changed, name, verdict, said):
    found = encoding(changed)[name]
    assert found.verdict == verdict
    assert said in found.reason


def bounded(count: float, bound: str) -> list[dict]:
    return [{"seed": seed, "devices": count, "bound": bound} for seed in SEEDS]


@pytest.mark.parametrize(
    ("ours", "theirs", "said", "low"),
    [
        ("exact", "exact", "3.0 (3.0 to 3.0) times it", 3.0),
        ("exact", "at most", "at least 3.0 times it", 3.0),
        ("at least", "exact", "at least 3.0 times it", 3.0),
        ("exact", "at least", "at most 3.0 times it", 0.0),
        ("at most", "exact", "at most 3.0 times it", 0.0),
        ("at most", "at most", "unknown, about 3.0 times it", 0.0),
    ],
)
def test_a_search_without_an_end_bounds_the_ratio(ours, theirs, said, low):
    found = devices_encoding.ratio(bounded(12, ours), bounded(4, theirs))
    assert (found.times("it"), found.low) == (said, pytest.approx(low))


def test_a_ratio_is_a_geometric_mean_over_seeds():
    ours = [{"seed": seed, "devices": count, "bound": "exact"} for seed, count in enumerate((10, 40, 20))]
    found = devices_encoding.ratio(ours, bounded(5, "exact"))
    half = 4.302652729911275 * math.log(2) / 3**0.5  # Student's t, 2 degrees of freedom
    assert found.mean == pytest.approx(4)
    assert (found.low, found.high) == pytest.approx((4 * math.exp(-half), 4 * math.exp(half)))


def test_seeds_that_were_extrapolated_are_counted():
    seeds = [{"seed": s, "devices": 10.0, "bound": "exact", "own_bound": "exact" if s else "at least"} for s in SEEDS]
    assert devices_encoding.counted(seeds) == "10 ± 0 (1 of 3 seeds extrapolated)"
    assert devices_encoding.counted(seeds[1:]) == "10 ± 0"


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({1: 1.0, 2: 2.0, 4: 3.0}, ("", "it does not fall from 1 to 2, 2 to 4")),
        ({1: 3.0, 2: 3.0, 4: 1.0}, ("it does not rise from 1 to 2, 2 to 4", "it does not fall from 1 to 2")),
        ({5: 1.0}, ("", "")),
    ],
)
def test_steps_against_a_trend_are_named(values, said):
    assert (setbacks(values), setbacks(values, rising=False)) == said


def cases_of_one_device(error: float, fall: float) -> dict[str, str]:
    records = [
        record(
            {"label": label, "between": "hold", "update_every": 1},
            score=1.0 - fall,
            failed=0.0,
            nmae=error,
            cost=50.0,
            bits_per_slot=8192 if label == "TS-JEPA" else 393216,
        )
        for label, error, fall in (("optimal", 0.0, 0.0), ("TS-JEPA", error, fall), ("supervised 2", 0.006, 0.0))
    ]
    return one_device.verdicts(records)


def test_reasons_name_what_the_figures_show():
    near, far = cases_of_one_device(0.007, 0.1), cases_of_one_device(0.1, 0.3)
    assert near["near_optimal"].reason == "it stays 10% below the expert on the true state"
    assert far["near_optimal"].reason == "it stays 30% below the expert on the true state"
    assert near["beats_baselines_prediction"].reason == "1.17 times the error of supervised 2"
    assert far["lowest_nmae"].reason == "not clearly below supervised 2"
    assert cases_of_one_device(0.004, 0.0)["lowest_nmae"].reason == ""


@pytest.mark.parametrize(("late", "verdict"), [(60, PARTLY), (40, REPRODUCED)])
def test_schedulers_are_compared_with_late_knowledge_too(late, verdict):
    counts = {("perfect", "max_age"): 30, ("late", "max_age"): late}
    counts |= {(case, "channel_aware"): 50 for case in ("perfect", "late")}
    records = [
        record({"case": case, "scheduler": scheduler, "also_at": 8}, devices=count)
        for (case, scheduler), count in counts.items()
    ]
    for entry in records:
        for row in entry["rows"]:
            row["bound"] = "exact"
        entry["rows"] += [{"seed": seed, "num_devices": 8, "mean_age": 2.0} for seed in SEEDS]
    found = schedulers.verdicts(records)["scheduler_helps"]
    assert found.verdict == verdict
    assert ("max_age (late)" in found.reason) == (verdict == PARTLY)
    assert "mean age in slots: channel_aware 2.0, max_age 2.0" in found.ours


@pytest.mark.parametrize(("falls", "verdict"), [((0.2, 0.9), REPRODUCED), ((0.01, 0.9), PARTLY), ((0.01, 0.02), NOT)])
def test_predicting_helps_where_more_would_fall_without(falls, verdict):
    def row(label, between, period, failed):
        point = {"label": label, "between": between, "update_every": period}
        return record(point, score=0.9, failed=failed, nmae=0.1, bits_per_slot=1)

    records = [row("optimal", "hold", 1, 0.0), row("TS-JEPA", "hold", 1, 0.0)]
    for period, failed in zip((5, 10), falls, strict=True):
        records += [row("TS-JEPA", "predict", period, 0.0), row("TS-JEPA", "hold", period, failed)]
    assert one_device.verdicts(records)["prediction_helps"].verdict == verdict


@pytest.mark.parametrize(("scores", "verdict"), [((0.3, 0.9), REPRODUCED), ((0.9, 0.91), NOT)])
def test_a_trend_within_the_noise_of_the_seeds_is_none(scores, verdict):
    records = []
    for width, score in zip((16, 256), scores, strict=True):
        entry = record({"dimension": width, "update_every": 10}, score=score)
        # the seeds differ by more than the widths do
        for row in entry["rows"]:
            row["score"] += 0.1 * (row["seed"] - 1) * (1 if width == 16 else -1)
        records.append(entry)
    assert dimension.verdicts(records)["dimension_score"].verdict == verdict


@pytest.mark.parametrize(("kept", "verdict"), [(90, REPRODUCED), (60, PARTLY), (40, NOT)])
def test_devices_kept_under_loss(kept, verdict):
    lossless = fleets(COUNTS, loss=0.0)
    lossy = fleets(COUNTS | {("TS-JEPA", "channel_aware"): kept, ("supervised, WebP", "channel_aware"): 7}, loss=0.5)
    found = devices_prediction.verdicts(lossless + lossy)
    assert found["supervised_loss"].verdict == verdict
    assert f"TS-JEPA keeps {kept}%" in found["supervised_loss"].ours
    assert found["devices_loss"].verdict == REPRODUCED


def sent(sends: str, codec: str, count: float, score: float) -> dict:
    model = "tsjepa-cartpole" if sends == "embedding" else "supervised-cartpole-k2"
    point = {"model": model, "sends": sends, "codec": codec, "quality": None, "update_every": 1}
    return record(point, bits_per_slot=count, score=score)


@pytest.mark.parametrize(
    ("embedding", "video", "goal", "claim"),
    [(300, 1000, REPRODUCED, REPRODUCED), (300, 200, REPRODUCED, PARTLY), (1000, 1500, PARTLY, REPRODUCED)],
)
def test_bits_of_the_cheapest_setting_that_scores_enough(embedding, video, goal, claim):
    found = bits.verdicts(
        [
            sent("embedding", "int8", embedding, 0.95),
            sent("embedding", "int4", 10, 0.5),
            sent("stream", "webp", 2000, 0.92),
            sent("stack", "webp", 400, 0.7),
            sent("stream", "raw", 200_000, 0.98),
            sent("video", "h264", video, 0.95),
        ]
    )
    assert (found["goal_bits"].verdict, found["fewer_bits"].verdict) == (goal, claim)
    assert f"embedding {embedding} (int8), still picture 2000 (webp), raw frame 200000" in found["goal_bits"].ours


def test_bits_are_not_compared_where_nothing_scores_enough():
    found = bits.verdicts([sent("embedding", "int8", 300, 0.8), sent("stream", "webp", 2000, 0.95)])
    assert {verdict.verdict for verdict in found.values()} == {NOT}


@pytest.mark.parametrize(("medians", "verdict"), [((1, 5, 20), REPRODUCED), ((1, 9, 8), PARTLY), ((9, 5, 2), NOT)])
def test_frames_further_apart(medians, verdict):
    records = [
        record({"interval_ms": ms, "augmentation": "none"}, median=median, percentile_90=2 * median, masked_share=0.9)
        for ms, median in zip((1, 5, 20), medians, strict=True)
    ]
    assert frame_change.verdicts(records)["interval_changes_frames"].verdict == verdict


@pytest.mark.parametrize(("ours", "theirs", "verdict"), [(0.9, 0.3, REPRODUCED), (0.4, 0.3, PARTLY), (0.2, 0.3, NOT)])
def test_sent_once(ours, theirs, verdict):
    common = {"update_every": 0}
    records = [
        record(common | {"label": label, "between": between}, score=score, nmae=0.1)
        for label, between, score in (("TS-JEPA", "predict", ours), ("optimal", "hold", theirs))
    ] + [
        record(common | {"update_every": 1, "label": label, "between": "hold"}, score=0.98, nmae=0.1, bits_per_slot=1)
        for label in ("TS-JEPA", "optimal")
    ]
    for entry in records:
        for row in entry["rows"]:
            row["nmae_by_slot"] = [0.1] * 8
    found = one_device.verdicts(records)
    assert found["once_score"].verdict == verdict
    assert found["near_optimal"].verdict == found["once_growth"].verdict == REPRODUCED


def colours(model: str, **trained: bool) -> dict:
    """The verdicts of the figure whose TS-JEPA is ``model``."""
    records = [
        record({"label": "TS-JEPA", "model": model}, colour_distance=0.08, neighbour_error=0.1),
        record({"label": "autoencoder", "model": "autoencoder-cartpole"}, colour_distance=0.3, neighbour_error=0.3),
    ]
    for row in records[0]["rows"]:
        row |= trained
    return tsne.verdicts(records)


def test_the_verdict_on_colours_says_of_which_model_it_is():
    found = colours("runs/appearance-actor/model", drawn_colours=True)["colour"]
    assert found.verdict == REPRODUCED
    assert "TS-JEPA is `runs/appearance-actor/model`, trained on drawn colours, the autoencoder" in found.ours
    plain = colours("tsjepa-cartpole", drawn_colours=False)["colour"].ours
    assert "`tsjepa-cartpole`, trained on one colour of each part" in plain
    # a record that does not say what it was trained on
    assert colours("tsjepa-cartpole")["colour"].ours.endswith(
        "TS-JEPA is `tsjepa-cartpole`, the autoencoder `autoencoder-cartpole`"
    )


@pytest.mark.parametrize(
    ("arguments", "drawn"),
    [
        ({}, False),
        ({"random_colors": True}, True),
        ({"appearance": Appearance(distractors=2)}, False),
        ({"appearance": Appearance(colors=True)}, True),
    ],
)
def test_a_model_of_drawn_colours_is_known_by_the_plant_that_it_was_trained_on(arguments, drawn):
    assert tsne.draws_colours(describe_plant(CartPole(**arguments))) is drawn


def test_a_model_of_a_recording_has_no_plant_that_draws_colours():
    assert tsne.draws_colours(None) is False
