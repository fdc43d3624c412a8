"""Long training does not run here; what it made is loaded and scored again on some of its card's own starts."""

import pytest

import tsjepa
from tsjepa.models import entries
from tsjepa.zoo import verify

LARGEST_ZOO = 60e6  # bytes
ENTRIES = {
    "tsjepa-cartpole",
    *(f"tsjepa-cartpole-d{width}" for width in (16, 32, 64, 128)),
    "tsjepa-cartpole-paper",
    "tsjepa-cartpole-appearance",
    "autoencoder-cartpole",
    "supervised-cartpole-k2",
    "supervised-cartpole-k4",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", entries.names())
def test_an_entry_scores_within_its_cards_interval(name, monkeypatch):
    monkeypatch.setattr(verify, "VERIFIED_SEEDS", 1)
    monkeypatch.setattr(verify, "VERIFIED_PERIODS", (5,))  # which needs encoder, predictor and actor
    checks = verify.rescore(tsjepa.load(name), name)
    assert checks and all(check.passed for check in checks), "; ".join(map(str, checks))


def test_the_zoo_is_whole():
    assert set(entries.names()) >= ENTRIES


def test_the_zoo_stays_small():
    assert sum(path.stat().st_size for path in entries.zoo_folder().rglob("*")) < LARGEST_ZOO
