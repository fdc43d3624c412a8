"""Physical systems: dynamics, pictures, scores and experts. Neither TorchRL nor Lightning is imported here.

MuJoCo and dm_control are imported when a plant is made: models and data sets load where they are not installed.
"""

from tsjepa.plants.appearance import Appearance
from tsjepa.plants.build import build_plant, describe_plant
from tsjepa.plants.cartpole import CartPole
from tsjepa.plants.double_cartpole import DoubleCartPole
from tsjepa.plants.gym_env import Gym
from tsjepa.plants.mixed import Mixed
from tsjepa.plants.mjcf import MuJoCo
from tsjepa.plants.mujoco_plant import MujocoPlant
from tsjepa.plants.pendulum import Pendulum
from tsjepa.plants.plant import Plant
from tsjepa.plants.reacher import Reacher
from tsjepa.plants.suite import Suite
from tsjepa.support.spec import PlantSpec

__all__ = [
    "Appearance",
    "CartPole",
    "DoubleCartPole",
    "Gym",
    "Mixed",
    "MuJoCo",
    "MujocoPlant",
    "Pendulum",
    "Plant",
    "PlantSpec",
    "Reacher",
    "Suite",
    "build_plant",
    "describe_plant",
]
