"""Counter-based random numbers: every draw is a pure function of (seed, device, episode, slot, purpose).

Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", 2011). A device's draws cannot depend on
what other devices do, nor on the order in which they are asked for.
"""

from __future__ import annotations

import numpy as np

START, NOISE, CART_COLOR, POLE_COLOR = range(4)
_MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)


def philox(counter: list[np.ndarray], key: tuple[int, int]) -> list[np.ndarray]:
    """Philox4x32-10 of four 32-bit counter words (uint64 arrays of one shape) under two key words; four words."""
    a, b, c, d = counter
    key_a, key_b = (np.uint64(word) for word in key)
    for _ in range(10):
        product_a, product_c = a * _MULTIPLIERS[0], c * _MULTIPLIERS[1]
        a, b, c, d = (
            (product_c >> _HALF) ^ b ^ key_a,
            product_c & _LOW,
            (product_a >> _HALF) ^ d ^ key_b,
            product_a & _LOW,
        )
        key_a, key_b = (key_a + _WEYL[0]) & _LOW, (key_b + _WEYL[1]) & _LOW
    return [a, b, c, d]


def uniforms(seed: int, purpose: int, device: np.ndarray, episode: np.ndarray, slot: np.ndarray) -> np.ndarray:
    """Four uniform numbers in (0, 1) for each of N (device, episode, slot) triples of integers; returns [N, 4]."""
    shape = np.broadcast_shapes(device.shape, episode.shape, slot.shape)
    words = [np.broadcast_to(v, shape).astype(np.uint64) & _LOW for v in (device, episode, slot, np.asarray(purpose))]
    drawn = philox(words, (seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF))
    return (np.stack(drawn, axis=-1) + 0.5) / 2.0**32


def normals(seed: int, purpose: int, device: np.ndarray, episode: np.ndarray, slot: np.ndarray) -> np.ndarray:
    """Two standard normal numbers for each of N (device, episode, slot) triples (Box-Muller); returns [N, 2]."""
    u = uniforms(seed, purpose, device, episode, slot)
    radius, angle = np.sqrt(-2.0 * np.log(u[..., 0])), 2.0 * np.pi * u[..., 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
