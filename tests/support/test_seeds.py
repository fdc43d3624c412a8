from tsjepa.support.seeds import derive, run_seed


def test_every_purpose_has_a_stream_of_its_own():
    purposes = [("windows", 0), ("windows", 1), ("augmentation", 0), ("windows", 10), ("windows1", 0), ()]
    seeds = {derive(seed, *purpose) for purpose in purposes for seed in (0, 1, 10)}
    assert len(seeds) == 3 * len(purposes)


def test_a_derived_seed_never_equals_one_given_by_hand():
    assert all(2**62 <= derive(seed, "windows") < 2**63 for seed in range(1000))


def test_a_stream_is_the_same_in_every_process():
    # BLAKE2b is a standard: this number holds for ever, or shipped results no longer repeat
    assert derive(0, "windows", 3) == 9158963122461411097


def test_the_seed_of_the_run_is_lightnings(monkeypatch):
    monkeypatch.delenv("PL_GLOBAL_SEED", raising=False)
    assert run_seed() == 0
    monkeypatch.setenv("PL_GLOBAL_SEED", "7")
    assert run_seed() == 7
