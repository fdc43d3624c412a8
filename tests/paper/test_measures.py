"""What the figures measure, against answers that are known."""

import numpy as np
import pytest
import torch

from tsjepa.paper import devices, frame_change, tsne
from tsjepa.paper.grids import grid
from tsjepa.paper.loops import loop_rows, starts_of, thinned

LOOP = {"model": None, "sends": "state", "codec": "fp32", "update_every": 1, "between": "hold"}
SIZES = {"seeds": 2, "starts": 6, "slots": 100, "process_noise_std": 0.0}


def test_a_grid_is_all_combinations_of_its_lists():
    assert grid({"a": 1, "b": [2, 3], "c": ["x", "y"]}) == [
        {"a": 1, "b": b, "c": c} for b in (2, 3) for c in ("x", "y")
    ]
    assert grid({"a": 1}) == [{"a": 1}]


def test_the_change_of_a_frame_leaves_out_what_is_not_known():
    previous = torch.tensor([0.0, 100.0, 200.0]).expand(1, 2, 2, 3)
    frames = torch.tensor([50.0, 150.0, 190.0]).expand(1, 2, 2, 3)
    assert frame_change.mape(frames, previous, previous != 0).item() == pytest.approx((50 + 5) / 2)
    # of a value that was 0 the change is over 1
    assert frame_change.mape(frames, previous, torch.ones(1, 2, 2, 3, dtype=bool)).item() == pytest.approx(5055 / 3)


def test_augmentation_counts_the_pixels_that_count_without_it():
    sizes = {"interval_ms": 20, "seeds": 1, "episodes": 2, "pairs": 3}
    plain, augmented = (frame_change.evaluate({"augmentation": kind} | sizes)[0] for kind in ("none", "independent"))
    assert plain["masked_share"] == augmented["masked_share"] > 0.8
    assert augmented["median"] > plain["median"]


def test_augmentation_of_no_strength_is_the_identity(monkeypatch):
    still = frame_change.Augmentation(0, 0, 0, 0, 0)
    monkeypatch.setattr(frame_change, "Augmentation", lambda: still)
    frames = torch.randint(0, 256, (3, 4, 5, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    assert torch.equal(frame_change.augmented(frames, torch.Generator().manual_seed(0)), frames.float())


def test_frames_further_apart_in_time_differ_more():
    rows = [
        frame_change.evaluate({"interval_ms": ms, "augmentation": "none", "seeds": 1, "episodes": 2, "pairs": 4})[0]
        for ms in (2, 20)
    ]
    assert 0 < rows[0]["median"] < rows[1]["median"]
    assert np.all(np.diff(rows[0]["quantiles"]) >= 0)


def test_the_expert_on_the_true_state_in_every_slot_scores_about_one():
    rows = loop_rows(LOOP | SIZES)
    assert [row["seed"] for row in rows] == [0, 1]
    assert all(row["bits_per_slot"] == 4 * 32 for row in rows)
    assert all(row["failed"] == 0 and row["score"] > 0.8 for row in rows)


def test_an_update_that_is_always_lost_is_never_heard():
    lost, none = loop_rows(LOOP | SIZES | {"loss": 1.0}), loop_rows(LOOP | SIZES | {"update_every": 200, "loss": 1.0})
    assert [row["cost"] for row in lost] == [row["cost"] for row in none]
    assert all(row["failed"] == 1 for row in lost)
    assert lost[0]["bits_per_slot"] == 128 and none[0]["bits_per_slot"] == 128 / 100


def test_half_of_the_bits_are_sent_with_an_update_in_every_other_slot():
    assert loop_rows(LOOP | SIZES | {"update_every": 2})[0]["bits_per_slot"] == 64


def test_starts_without_a_score_are_refused():
    with pytest.raises(ValueError, match="perfect feedback"):
        loop_rows(LOOP | SIZES | {"starts": 1, "slots": 2})


def test_every_controller_meets_the_same_starts():
    assert starts_of(LOOP | SIZES, 0) == starts_of(LOOP | SIZES | {"model": "tsjepa-cartpole"}, 0)


def test_a_curve_is_averaged_over_five_slots():
    assert thinned(torch.arange(12.0)) == [2.0, 7.0]


LOG_LINEAR = {"first is typical": (0.0, 0.03, -0.03), "first is the best": (0.2, -0.1, -0.1)}


@pytest.mark.parametrize("shifts", LOG_LINEAR.values(), ids=LOG_LINEAR)
@pytest.mark.parametrize(
    ("crossing", "tried", "bound"),
    [
        (50, {45, 64}, "exact"),
        (9, {8, 11}, "exact"),
        (120, {91, 128}, "exact"),
        (6, {8}, "at most"),
        (129, {128}, "at least"),
    ],
)
def test_a_bracket_holds_the_known_crossing_of_a_falling_score(crossing, tried, bound, shifts):
    asked = []

    def scores(size, seeds):
        asked.append((size, seeds))
        return [0.74 - 0.3 * np.log2(size / crossing) + shift for shift in shifts[:seeds]]

    sizes = devices.sizes_between(8, 128)
    assert sizes == [8, 11, 16, 23, 32, 45, 64, 91, 128]
    curve, found = devices.bracket(scores, sizes, 3)
    assert (set(curve), found) == (tried, bound)
    assert len({size for size, seeds in asked if seeds == 3}) <= 4
    if bound == "exact":
        # every seed's own crossing, also where it lies beyond the two sizes
        assert devices.crossings(curve) == pytest.approx([crossing * 2 ** (shift / 0.3) for shift in shifts])
    else:
        assert devices.crossings(curve) == [*tried] * 3


def test_where_the_score_hardly_falls_the_next_size_tells_how_far_seeds_are_apart():
    means, shifts = {16: 0.77, 23: 0.73, 32: 0.3}, (-0.1, 0.0, 0.1)
    curve, bound = devices.bracket(lambda size, seeds: [means[size] + s for s in shifts[:seeds]], list(means), 3)
    assert (set(curve), bound) == (set(means), "exact")
    middle, slope = 16 * (23 / 16) ** 0.75, 0.47  # the score falls by .47 from 16 to 32, an octave
    assert devices.crossings(curve) == pytest.approx([middle * 2 ** (shift / slope) for shift in shifts])


def test_sizes_that_do_not_ascend_are_refused():
    with pytest.raises(ValueError, match="smallest"):
        devices.sizes_between(5, 5)


FLEET = {"model": None, "codec": "fp32", "resource_blocks": 3, "snr_target_db": 10, "snr_threshold_db": 5.0}
FLEET |= {"smallest": 6, "largest": 16, "also_at": 7, "seeds": 2, "slots": 100, "process_noise_std": 0.008}


def test_a_fleet_of_a_point_is_searched_and_measured():
    rows = {name: devices.device_rows(FLEET | {"scheduler": name}) for name in ("channel_aware", "round_robin")}
    for mine in rows.values():
        assert {row["seed"] for row in mine if "devices" in row} == {0, 1}
        assert {row["num_devices"] for row in mine if "score" in row} >= {7}
    count = {name: sum(row["devices"] for row in mine if "devices" in row) for name, mine in rows.items()}
    assert count["channel_aware"] > count["round_robin"]


def test_bursts_lose_the_share_that_is_asked_for():
    point = FLEET | {"loss": 0.2, "burst_slots": 5}
    process = devices.radio_of(point, devices.Plants(), None, None).loss
    assert process.mean == pytest.approx(0.2)
    assert 1 / process.bad_to_good == 5


def test_bandwidth_scales_the_resource_units():
    units = [devices.Radio(bandwidth_mhz=mhz).units(0.02) for mhz in (20.0, 1.0, 0.5)]
    assert units == [2120, 106, 53]


def test_colour_distance_of_a_blind_and_of_a_colour_encoder():
    generator = torch.Generator().manual_seed(0)
    state, colour = torch.randn(200, 8, generator=generator), torch.randn(2, 200, 8, generator=generator)
    assert tsne.colour_distance(state, state) == 0
    assert tsne.colour_distance(colour[0], colour[1]) == pytest.approx(1, abs=0.1)


def test_neighbour_error_of_the_state_itself_and_of_noise():
    generator = torch.Generator().manual_seed(0)
    state, noise = torch.randn(400, 4, generator=generator), torch.randn(400, 4, generator=generator)
    trajectory = torch.arange(400) % 20
    assert tsne.neighbour_error(state[:, :2], state, trajectory) < 0.2
    assert tsne.neighbour_error(noise, state, trajectory) == pytest.approx(1, abs=0.05)


def test_a_map_holds_the_trajectories_and_the_marked_pairs():
    pytest.importorskip("sklearn")
    (point,) = tsne.points({"TS-JEPA": "tsjepa-cartpole"}, 2, trajectories=4, slots=12, every=1, pairs=12, marked=3)
    rows = tsne.evaluate(point)
    assert len(rows[0]["position"]) == 4 * 12
    assert len(rows[0]["x"]) == len(rows[0]["y"]) == 4 * 12 + 2 * 3
    assert "x" not in rows[1]
    assert all(row["colour_distance"] > 0 and 0 < row["neighbour_error"] < 1 for row in rows)
