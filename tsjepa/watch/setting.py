"""What the sliders set, and what the running fleet tells of itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tsjepa.evaluation.rollouts import Loop
from tsjepa.radio import IidLoss


@dataclass
class Setting:
    """What can be changed while a fleet runs.

    Args:
        devices: I.
        snr_db: mean SNR that power control gives every device.
        loss: probability that an update is lost beside the SNR.
        scheduler: a name in ``tsjepa.radio.SCHEDULERS``.
        codec: how an update is sent, which decides how many bits it takes.
    """

    devices: int
    snr_db: float
    loss: float
    scheduler: str
    codec: str


@dataclass(frozen=True)
class Snapshot:
    """A running fleet at one moment.

    Args:
        setting: with which it runs.
        slot: since the start of the program.
        pace: seconds of the plants in a second of the wall clock, over the last two seconds; 1 is real time.
        complaint: why the setting that was asked for is not the one it runs with; empty if it is.
        scenes: [I, s], what the cameras see.
        beliefs: [I, d], the embeddings by which the controller acts; None where it acts by none.
        heard: [I] bool, whether the controller has heard of the device since its last start.
        sent, delivered: [I] bool, in any slot since the snapshot before.
        age: [I] slots.
        score: [I] in 0..1, mean of about the last two seconds.
        failed: [I] bool, where the plant is beyond recovery now.
        bit_rate: bits of updates in a second, mean of about the last two seconds.
    """

    setting: Setting
    slot: int
    pace: float
    complaint: str
    scenes: np.ndarray
    beliefs: np.ndarray | None
    heard: np.ndarray
    sent: np.ndarray
    delivered: np.ndarray
    age: np.ndarray
    score: np.ndarray
    failed: np.ndarray
    bit_rate: float


def with_setting(loop: Loop, setting: Setting) -> Loop:
    """The loop whose fleet and radio are as the sliders say, and otherwise as they were."""
    loss = IidLoss(setting.loss) if setting.loss else None
    radio = replace(loop.radio, snr_target_db=setting.snr_db, loss=loss, codec=setting.codec)
    return replace(loop, num_devices=setting.devices, scheduler=setting.scheduler, radio=radio)
