"""One seed for a run; every stream of random numbers is derived from it with a purpose of its own."""

from __future__ import annotations

import hashlib
import os

HELD_OUT = 1_000_000  # seeds of the evaluation's starts; every other stream has a key of 63 bits with the top one set


def derive(seed: int, *purpose: str | int) -> int:
    """Seed of the stream with that purpose, in [2**62, 2**63): no two purposes share one, and none is a small number
    that somebody gives by hand.

    Callers that name one purpose draw from one stream. Only those do that take each other's place, so that what they
    make of it can be compared.

    Args:
        seed: of the run.
        purpose: words and numbers, such as ``("windows", epoch)``.
    """
    digest = hashlib.blake2b(repr((seed, *purpose)).encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") >> 2 | 1 << 62


def run_seed() -> int:
    """The seed of this run: that of Lightning's ``seed_everything``, 0 where nobody has set one."""
    return int(os.environ.get("PL_GLOBAL_SEED", 0))
