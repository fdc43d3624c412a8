"""The chain from plant to controller, one TorchRL transform per box.

Order in a ``Compose``: Drive, Channel (or TraceChannel), Scheduler, Camera, Encode, Codec, Uplink, Acknowledge, Delay,
Energy, Actuator, Estimator (or HierarchicalEstimator), HoldCommand; leave out what the experiment does not have. Where
devices watch all the time, Camera, Encode, Observe and Urgency stand before the Scheduler; so do ExpectedGain and
AgeCost.
"""

from tsjepa.envs.transforms.actuator import Actuator
from tsjepa.envs.transforms.age_cost import AgeCost
from tsjepa.envs.transforms.camera import Camera, Encode
from tsjepa.envs.transforms.channel import Channel
from tsjepa.envs.transforms.delay import Acknowledge, Delay
from tsjepa.envs.transforms.drive import Drive
from tsjepa.envs.transforms.energy import Energy
from tsjepa.envs.transforms.estimator import Estimator, HoldCommand, linear_model
from tsjepa.envs.transforms.hierarchy import HierarchicalEstimator
from tsjepa.envs.transforms.observe import Observe
from tsjepa.envs.transforms.scheduler import Scheduler
from tsjepa.envs.transforms.trace_channel import TraceChannel
from tsjepa.envs.transforms.uplink import Codec, Uplink
from tsjepa.envs.transforms.urgency import ExpectedGain, Twin, Urgency

__all__ = [
    "Acknowledge",
    "Actuator",
    "AgeCost",
    "Camera",
    "Channel",
    "Codec",
    "Delay",
    "Drive",
    "Encode",
    "Energy",
    "Estimator",
    "ExpectedGain",
    "HierarchicalEstimator",
    "HoldCommand",
    "Observe",
    "Scheduler",
    "TraceChannel",
    "Twin",
    "Uplink",
    "Urgency",
    "linear_model",
]
