"""Where plants, radio and models meet, in TorchRL: the fleet, the transforms of the chain, ``make_env``.

TorchRL comes first: it loads triton, and triton loaded after an EGL context exists crashes the process.
"""

import torchrl  # noqa: F401

from tsjepa.envs.fleet import FleetEnv

__all__ = ["FleetEnv"]
