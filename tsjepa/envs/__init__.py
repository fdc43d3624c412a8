"""The plant: the cart-pole, its camera, the single-device environment and the fleet.

TorchRL comes first: it loads triton, and triton loaded after an EGL context exists crashes the process.
The rest is imported on first use, so that `tsjepa.envs.expert` works where MuJoCo and dm_control are not installed.
"""

from importlib import import_module

import torchrl  # noqa: F401

_HOMES = {
    "CartPolePhysics": "physics",
    "FleetEnv": "fleet",
    "Regulation": "task",
    "Renderer": "camera",
    "StartDistribution": "starts",
    "make_env": "plant",
}
__all__ = list(_HOMES)


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module 'tsjepa.envs' has no attribute {name!r}")
    return getattr(import_module(f"tsjepa.envs.{_HOMES[name]}"), name)
