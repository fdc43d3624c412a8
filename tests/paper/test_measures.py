"""What the figures measure, against answers that are known."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tsjepa.evaluation import rollouts
from tsjepa.paper import devices, frame_change, tsne
from tsjepa.paper.grids import grid
from tsjepa.paper.rows import command_rows, expert_embeddings, loop_of, loop_rows, thinned

pytestmark = pytest.mark.slow  # closes loops

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


@pytest.mark.parametrize("model", ["tsjepa-cartpole-d16", "supervised-cartpole-k4"])
def test_every_controller_meets_the_same_starts(model):
    theirs = {"model": model, "sends": "embedding", "between": "hold"}
    first, second = (loop_of(LOOP | SIZES | fields).env(1).reset()["physics_state"] for fields in ({}, theirs))
    assert torch.equal(first, second)


def test_what_a_device_cannot_send_is_refused():
    with pytest.raises(ValueError, match="'smoke'"):
        loop_rows(LOOP | SIZES | {"sends": "smoke"})


def test_nothing_counts_after_a_fall():
    once = LOOP | SIZES | {"update_every": 0, "starts": 20, "seeds": 1}
    loop = loop_of(once)
    run = rollouts.run(loop, 0)
    fallen = run.failed_now[1:].cummax(0).values
    assert fallen.any()
    row = loop_rows(once)[0]
    inside = (run.state[1:, :, 0].abs() <= 0.05) & (run.state[1:, :, 1].abs() <= 0.05)
    assert row["raw_score"] == pytest.approx(float((inside & ~fallen).float().mean()))
    assert row["optimal_policy"] == "reference LQR"


def test_the_command_error_is_the_experts_own_where_it_is_told_the_state():
    (row,) = command_rows(LOOP | SIZES | {"seeds": 1})
    assert row["nmae"] == 0


def test_a_held_command_errs_by_its_distance_to_the_experts_over_the_range():
    point = LOOP | SIZES | {"seeds": 1, "update_every": 2}
    (row,) = command_rows(point)
    perfect = rollouts.run(loop_of(LOOP | SIZES), 0).action
    held = perfect.clone()
    held[1::2] = perfect[::2]
    assert row["nmae"] == pytest.approx(float((held - perfect).abs().mean()) / 40, rel=1e-5)


def test_embeddings_of_the_loop_that_the_expert_closes_come_with_their_states():
    point = {"model": "tsjepa-cartpole-d16", "starts": 2, "slots": 6, "process_noise_std": 0.0}
    embedding, state = expert_embeddings(point, 0, 3)
    perfect = rollouts.run(loop_of(LOOP | SIZES | {"starts": 2, "slots": 6}), 0)
    assert embedding.shape == (4, 16)
    assert torch.equal(state, perfect.state[[0, 3]].flatten(0, 1))
    assert torch.allclose(embedding.norm(dim=-1), torch.ones(4), atol=1e-5)


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
    process = devices.loop_of(point | {"scheduler": "max_age"}).radio.loss
    assert process.mean == pytest.approx(0.2)
    assert 1 / process.bad_to_good == 5


@pytest.mark.parametrize(("bandwidth_mhz", "units"), [(20.0, 2120), (1.0, 106), (0.5, 53), (0.25, 26), (0.125, 13)])
def test_devices_are_scaled_by_the_whole_units_that_a_slot_has(bandwidth_mhz, units):
    point = FLEET | {"scheduler": "max_age", "resource_blocks": None, "bandwidth_mhz": bandwidth_mhz}
    loop = devices.loop_of(point)
    assert loop.radio.units(loop.plant.spec.slot) == units
    assert devices.per_full_bandwidth(loop) == 2120 / units


def test_where_blocks_are_counted_nothing_is_scaled():
    assert devices.per_full_bandwidth(devices.loop_of(FLEET | {"scheduler": "max_age"})) == 1


def test_a_seed_that_never_crosses_is_named_a_bound():
    curve = {8: [0.9, 0.8, 0.7], 16: [0.8, 0.6, 0.6]}
    found = devices.found(curve, "exact", 2.0)
    assert [row["own_bound"] for row in found] == ["at least", "exact", "at most"]
    assert [row["bound"] for row in found] == ["exact"] * 3
    assert found[0]["devices"] > 32 and 16 < found[1]["devices"] < 32 and found[2]["devices"] < 16


def test_pictures_reserve_a_tenth_more_than_the_largest_of_them():
    point = FLEET | {"scheduler": "max_age", "model": "supervised-cartpole-k2", "resource_blocks": None}
    small, large = (devices.loop_of(point | {"codec": "webp", "quality": q}).radio.payload_bits for q in (1, 80))
    assert 1000 < small < large / 2
    assert devices.loop_of(point | {"codec": "raw"}).radio.payload_bits is None


def test_a_model_that_holds_its_command_does_not_predict():
    point = FLEET | {"scheduler": "round_robin", "model": "tsjepa-cartpole-d16"}
    predicts, holds = (devices.loop_of(point | fields) for fields in ({}, {"between": "hold"}))
    actions = [rollouts.run(replace(loop, num_devices=6, slots=4), 0) for loop in (predicts, holds)]
    unsent = ~actions[1].delivered[1:]
    assert unsent.any()
    assert torch.equal(actions[1].action[1:][unsent], actions[1].action[:-1][unsent])
    assert not torch.equal(actions[0].action[1:][unsent], actions[0].action[:-1][unsent])


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
    (point,) = tsne.points({"TS-JEPA": "tsjepa-cartpole"}, 2, trajectories=8, slots=40, every=2, pairs=12, marked=3)
    rows = tsne.evaluate(point)
    assert len(rows[0]["position"]) == 8 * 20
    assert len(rows[0]["x"]) == len(rows[0]["y"]) == 8 * 20 + 2 * 3
    assert "x" not in rows[1]
    assert all(row["colour_distance"] > 0 and 0 < row["neighbour_error"] < 1 for row in rows)
