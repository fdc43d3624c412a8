"""Where plants, radio and models meet, in TorchRL: the fleet, the transforms of the chain, ``make_env``.

TorchRL comes first: it loads triton, and triton loaded after an EGL context exists crashes the process.
"""

import torchrl  # noqa: F401

from tsjepa.envs.fleet import FleetEnv
from tsjepa.envs.make import make_env, make_policy
from tsjepa.envs.settings import Radio

__all__ = ["FleetEnv", "Radio", "make_env", "make_policy"]
