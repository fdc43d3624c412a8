"""The search for the largest fleet, on score curves that are known."""

import pytest

from tsjepa.evaluation.search import crossing, largest, search, table

LIMITS = {"channel_aware": 47, "round_robin": 23, "oracle": 10_000, "none": 0}


def score(scheduler, size):
    """Three seeds that fall through 0.74 at the scheduler's limit, at one device less and at one more."""
    return [0.74 + (LIMITS[scheduler] + seed - size) / 1000 if LIMITS[scheduler] else 0.0 for seed in (-1, 0, 1)]


def test_the_largest_fleet_is_found_to_the_device():
    asked = []

    def counted(scheduler, size):
        asked.append((scheduler, size))
        return score(scheduler, size)

    curves = search(counted, list(LIMITS), [10, 20, 40, 80], 0.74)
    rows = {row["scheduler"]: row for row in largest(curves, 0.74)}
    assert {name: (row["largest_num_devices"], row["bound"]) for name, row in rows.items()} == {
        "channel_aware": (47, "exact"),
        "round_robin": (23, "exact"),
        "oracle": (80, "at least"),
        "none": (10, "at most"),
    }
    assert len(asked) == len(set(asked))
    assert [size for name, size in asked if name == "none"] == [10]  # hopeless: larger fleets are not tried
    assert rows["channel_aware"]["mean"] == pytest.approx(47)
    assert rows["channel_aware"]["per_seed"] == pytest.approx([46, 47, 48])
    assert rows["round_robin"]["channel_aware_ahead_by"] == pytest.approx(24)
    assert rows["round_robin"]["ahead_interval_95"] == pytest.approx(0, abs=1e-9)  # paired: the seeds' spread cancels
    assert [row["scheduler"] for row in largest(curves, 0.74)] == ["oracle", "channel_aware", "round_robin", "none"]
    lines = table(list(rows.values())).splitlines()
    assert len(lines) == 5
    assert any(">= 80" in line for line in lines)
    assert rows["oracle"]["mean_bound"] == "at least"
    assert rows["none"]["mean_bound"] == "at most"
    assert rows["oracle"]["interval_95"] is rows["none"]["interval_95"] is None
    assert rows["oracle"]["channel_aware_ahead_by"] is None


def test_a_seed_that_never_crosses_bounds_the_mean_and_leaves_no_interval():
    curves = {
        "channel_aware": {10: [0.9, 0.9, 0.9], 20: [0.8, 0.6, 0.6]},  # the mean crosses, the first seed does not
        "round_robin": {10: [0.9, 0.9, 0.9], 20: [0.6, 0.6, 0.6]},
        "random": {10: [0.9, 0.6, 0.9], 20: [0.8, 0.6, 0.6]},
    }
    rows = {row["scheduler"]: row for row in largest(curves, 0.75)}
    censored = rows["channel_aware"]
    assert (censored["bound"], censored["mean_bound"]) == ("exact", "at least")
    assert censored["bounds_per_seed"] == ["at least", "exact", "exact"]
    assert censored["per_seed"] == pytest.approx([20, 15, 15])
    assert censored["mean"] == pytest.approx(50 / 3)
    assert censored["interval_95"] is None
    assert rows["round_robin"]["interval_95"] == pytest.approx(0, abs=1e-9)
    # by how much the one is ahead of the other is not known either
    assert rows["round_robin"]["channel_aware_ahead_by"] is None
    assert rows["random"]["bounds_per_seed"] == ["at least", "at most", "exact"]
    assert rows["random"]["mean_bound"] is None
    lines = {line.split()[0]: line for line in table(list(rows.values())).splitlines()}
    assert ">= 16.7" in lines["channel_aware"]
    assert "±" in lines["round_robin"]
    assert lines["random"].split()[-1] == "-"


def test_a_curve_is_followed_to_its_first_crossing():
    size, bound = crossing({10: 1.0, 20: 0.9, 30: 0.5, 40: 0.8}, 0.7)
    assert (size, bound) == (pytest.approx(25), "exact")
    assert crossing({10: 1.0, 20: 0.9}, 0.7) == (20, "at least")
    assert crossing({10: 0.2, 20: 0.1}, 0.7) == (10, "at most")


@pytest.mark.parametrize("sizes", [[10], [20, 10], [10, 10], [0, 5]])
def test_sizes_must_ascend(sizes):
    with pytest.raises(ValueError, match="search_over"):
        search(score, ["none"], sizes, 0.74)
