"""The chain from plant to controller, one TorchRL transform per box.

Order in a ``Compose``: Drive, Channel, Scheduler, Camera, Encode, Codec, Uplink, Estimator, HoldCommand; leave
out what the experiment does not have. Where devices watch all the time, Camera, Encode and Urgency stand before the
Scheduler; so does ExpectedGain.
"""

from tsjepa.envs.transforms.camera import Camera, Encode
from tsjepa.envs.transforms.channel import Channel
from tsjepa.envs.transforms.drive import Drive
from tsjepa.envs.transforms.estimator import Estimator, HoldCommand, linear_model
from tsjepa.envs.transforms.scheduler import Scheduler
from tsjepa.envs.transforms.uplink import Codec, Uplink
from tsjepa.envs.transforms.urgency import ExpectedGain, Twin, Urgency

__all__ = [
    "Camera",
    "Channel",
    "Codec",
    "Drive",
    "Encode",
    "Estimator",
    "ExpectedGain",
    "HoldCommand",
    "Scheduler",
    "Twin",
    "Uplink",
    "Urgency",
    "linear_model",
]
