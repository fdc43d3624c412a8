"""The links of a radio as a trace, without plants."""

from __future__ import annotations

import torch

from tsjepa.envs.radio_end import channel
from tsjepa.envs.settings import Radio
from tsjepa.radio.traces import Trace


def links(radio: Radio, num_devices: int, slots: int, slot_s: float, seed: int = 0) -> Trace:
    """What the channel of each device is in each slot of its first episode, whoever is scheduled.

    The columns are ``snr_db`` (``sinr_db`` with interference), with a loss model ``lost`` (1: a packet of this slot is
    erased, whatever its SNR), and with a delay ``delay_ms``. Of a radio that plays a trace they are what is played.

    Raises:
        ValueError: a lossless radio, which has no links.
    """
    if radio.lossless:
        raise ValueError("A lossless radio has no links to write: leave lossless out.")
    (part,) = channel(slot_s, num_devices, radio, seed)
    played = torch.stack(list(part.alone(num_devices, slots)), 1)
    values = {}
    if "snr" in played:
        decibel = 10 * torch.log10(played["snr"].double())
        # where a trace has measured nothing yet, there is nothing to write either
        values["sinr_db" if radio.interference_rise_db else "snr_db"] = decibel.masked_fill(decibel.isinf(), torch.nan)
    if "erased" in played:
        values["lost"] = played["erased"].double()
    device, slot = torch.arange(num_devices).unsqueeze(-1), torch.arange(slots)
    if isinstance(radio.delay, str):  # "trace"
        values["delay_ms"] = played["delay_ms"]
    elif radio.delay is not None:
        drawn = radio.delay.draw(seed, device, torch.zeros_like(device), slot)
        values["delay_ms"] = drawn * (1e3 * slot_s if radio.delay.unit == "slots" else 1.0)
    return Trace(
        (slot.to(torch.float64) * slot_s).repeat(num_devices),
        device.expand(-1, slots).flatten(),
        tuple(str(number) for number in range(num_devices)),
        {name: column.flatten() for name, column in values.items()},
    )
