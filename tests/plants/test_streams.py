"""Counter-based random numbers: Philox against its authors' vectors, and what is drawn from it."""

from __future__ import annotations

import numpy as np
import pytest

from tsjepa.plants import CartPole, DoubleCartPole
from tsjepa.plants.streams import NOISE, normals, philox, uniforms

ZERO = np.zeros(1, np.int64)


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
        ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
    ],
)
def test_philox_matches_random123_known_answers(counter, key, expected):
    words = [np.array([int(word, 16)], np.uint64) for word in counter.split()]
    drawn = philox(words, tuple(int(word, 16) for word in key.split()))
    assert " ".join(f"{int(word[0]):08x}" for word in drawn) == expected


def test_a_draw_depends_on_its_own_counters_only():
    devices, episodes = np.arange(50), np.arange(50) % 3
    together = uniforms(7, NOISE, devices, episodes, ZERO)
    np.testing.assert_array_equal(uniforms(7, NOISE, devices[31:32], episodes[31:32], ZERO)[0], together[31])
    assert len(np.unique(together)) == together.size


@pytest.mark.parametrize("change", ["seed", "high half of the seed", "device", "episode", "slot"])
def test_every_part_of_the_key_matters(change):
    one = np.ones(1, np.int64)
    drawn = normals(
        {"seed": 1, "high half of the seed": 2**32}.get(change, 0),
        NOISE,
        one if change == "device" else ZERO,
        one if change == "episode" else ZERO,
        one if change == "slot" else ZERO,
    )
    assert (drawn != normals(0, NOISE, ZERO, ZERO, ZERO)).all()


def test_normals_are_standard_and_uncorrelated():
    drawn = normals(3, NOISE, np.arange(40_000), ZERO, ZERO)
    np.testing.assert_allclose(drawn.mean(0), 0.0, atol=0.02)
    np.testing.assert_allclose(np.cov(drawn.T), np.eye(2), atol=0.03)


def test_starts_fill_their_half_widths():
    widths = (0.8, 0.3, 0.1, 0.0)
    drawn = CartPole(start_half_widths=widths).start(0, np.arange(5000), ZERO)
    assert (np.abs(drawn) <= widths).all()
    np.testing.assert_allclose(np.abs(drawn).max(0), widths, rtol=0.01)


def test_colors_are_visible_and_differ_between_cart_and_pole():
    scenes = CartPole(random_colors=True).scene(np.zeros((2000, 4)), 0, np.arange(2000), ZERO)
    drawn = scenes[:, 2:].reshape(2000, 2, 3)
    assert drawn.min() >= 0.25 and drawn.max() <= 1.0
    assert abs(np.corrcoef(drawn[:, 0, 0], drawn[:, 1, 0])[0, 1]) < 0.1


@pytest.mark.parametrize("std", [-0.1, (0.1, -0.1), (0.1, 0.1, 0.1), float("nan")])
def test_an_impossible_noise_is_refused(std):
    with pytest.raises(ValueError, match="process_noise_std"):
        CartPole(process_noise_std=std)


def test_an_impossible_start_is_refused():
    with pytest.raises(ValueError, match="start_half_widths"):
        CartPole(start_half_widths=(0.1, -0.1, 0.0, 0.0))


def test_each_rate_has_noise_of_its_own():
    plant, count = DoubleCartPole(0.001, process_noise_std=(0.03, 0.05, 0.1)), 3000
    devices, zeros = np.arange(count), np.zeros(count, np.int64)
    still = np.zeros((count, 6))
    rates = plant.advance(still, np.zeros((count, 1)), 0, devices, zeros, zeros)[:, 3:]
    np.testing.assert_allclose(rates.std(0), (0.03, 0.05, 0.1), rtol=0.05)
    assert np.abs(np.corrcoef(rates.T) - np.eye(3)).max() < 0.08
