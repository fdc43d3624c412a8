"""Physical systems: dynamics, pictures, scores and experts. Neither TorchRL nor Lightning is imported here.

MuJoCo and dm_control are imported when a plant is made: models and data sets load where they are not installed.
"""

from tsjepa.plants.build import build_plant, describe_plant
from tsjepa.plants.cartpole import CartPole
from tsjepa.plants.double_cartpole import DoubleCartPole
from tsjepa.plants.pendulum import Pendulum
from tsjepa.plants.plant import Plant
from tsjepa.plants.reacher import Reacher
from tsjepa.support.spec import PlantSpec

__all__ = [
    "CartPole",
    "DoubleCartPole",
    "Pendulum",
    "Plant",
    "PlantSpec",
    "Reacher",
    "build_plant",
    "describe_plant",
]
