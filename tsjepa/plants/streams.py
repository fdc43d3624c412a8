"""Counter-based random numbers: every draw is a pure function of (seed, device, episode, slot, purpose).

Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", 2011). A device's draws cannot depend on
what other devices do, nor on the order in which they are asked for.
"""

from __future__ import annotations

import numpy as np

# Purposes. COLOR + i belongs to the i-th coloured part, DISTRACTOR + i to the i-th distractor; a draw of many numbers
# uses purpose + BLOCK, + 2 BLOCK, ...
START, NOISE, COLOR, REFERENCE = 0, 1, 2, 500
LIGHT, SHIFT, OCCLUDER, DISTRACTOR = 600, 601, 602, 700
BLOCK = 1000
_MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_ZERO = np.zeros(1, np.int64)


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


def uniforms(
    seed: int, purpose: int, device: np.ndarray, episode: np.ndarray, slot: np.ndarray = _ZERO, count: int = 4
) -> np.ndarray:
    """``count`` uniform numbers in (0, 1) for each of N (device, episode, slot) triples of integers; [N, count]."""
    shape = np.broadcast_shapes(device.shape, episode.shape, slot.shape)
    triple = [np.broadcast_to(values, shape).astype(np.uint64) & _LOW for values in (device, episode, slot)]
    key = (seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF)
    blocks = [
        philox([*triple, np.full(shape, purpose + BLOCK * block, np.uint64)], key) for block in range(-(-count // 4))
    ]
    drawn = np.stack([word for block in blocks for word in block], axis=-1)[..., :count]
    return (drawn + 0.5) / 2.0**32


def normals(
    seed: int, purpose: int, device: np.ndarray, episode: np.ndarray, slot: np.ndarray, count: int = 2
) -> np.ndarray:
    """``count`` standard normal numbers for each of N (device, episode, slot) triples (Box-Muller); [N, count]."""
    pairs = []
    for block in range(-(-count // 2)):
        u = uniforms(seed, purpose + BLOCK * block, device, episode, slot, 2)
        radius, angle = np.sqrt(-2.0 * np.log(u[..., 0])), 2.0 * np.pi * u[..., 1]
        pairs += [radius * np.cos(angle), radius * np.sin(angle)]
    return np.stack(pairs[:count], axis=-1)
