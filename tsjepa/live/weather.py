"""Losses and delays at the socket, drawn by the radio's own models: those that a simulation with this seed meets."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from tsjepa.envs.settings import Radio
from tsjepa.envs.transforms import TraceChannel
from tsjepa.radio.delay import ConstantDelay, DelayLaw, UniformDelay
from tsjepa.radio.link import db_to_linear
from tsjepa.radio.loss import IidLoss, erased
from tsjepa.radio.streams import uniform
from tsjepa.support.checks import within

BLOCK = 1024  # slots drawn at once
LONGEST_MS = 10_000.0


class Weather:
    """What becomes of the packet that a device sends, or is sent, in a slot.

    Args:
        loss: probability that it is lost.
        delay: milliseconds that it travels.
        jitter: milliseconds by which it may take longer; each delay from ``delay`` to ``delay + jitter`` is as likely.
        trace: file of measured links, see :mod:`tsjepa.radio.traces`, whose losses and delays come on top.
        seed: of all draws, as that of a simulation.
        slot_s: seconds per slot.
        downlink: of commands instead of updates.

    Raises:
        ValueError: an argument that cannot be.
    """

    def __init__(
        self,
        loss: float = 0.0,
        delay: float = 0.0,
        jitter: float = 0.0,
        trace: str | None = None,
        seed: int = 0,
        slot_s: float = 0.02,
        downlink: bool = False,
    ) -> None:
        within(0, LONGEST_MS, delay=delay, jitter=jitter)
        within(0, 1, loss=loss)
        self.loss, self.seed, self.downlink = IidLoss(loss), seed, downlink
        self.law: DelayLaw = UniformDelay(delay, delay + jitter, "ms") if jitter else ConstantDelay(delay, "ms")
        self.trace = None if trace is None else TraceChannel(trace, slot_s, seed=seed)
        self._blocks: dict[int, tuple[tuple[int, int], list[float]]] = {}

    def delay(self, device: int, episode: int, slot: int) -> float:
        """Seconds from the slot's start until a packet arrives, 0 for one that is not delayed; infinite if it is lost.

        Args:
            device: its number.
            episode: 0 for the first.
            slot: from 0 in the episode.
        """
        number, place = divmod(slot, BLOCK)
        key, delays = self._blocks.get(device, (None, []))
        if key != (episode, number):
            delays = self._draw(device, episode, number * BLOCK)
            self._blocks[device] = (episode, number), delays
        return delays[place]

    def _draw(self, device: int, episode: int, first: int) -> list[float]:
        slot = torch.arange(first, first + BLOCK)
        who = torch.full_like(slot, device), torch.full_like(slot, episode)
        stream = "downlink_delay" if self.downlink else "delay"
        delay = self.law.draw(self.seed, *who, slot, stream=stream)
        lost = self._lost(*who, slot)
        if self.trace is not None:
            played = self.trace.played(*who, slot)
            lost = lost | played.get("erased", torch.zeros_like(lost))
            if "snr" in played:
                lost = lost | (played["snr"] < db_to_linear(Radio().snr_threshold_db))
            delay = delay + played.get("delay_ms", 0.0)
        return (1e-3 * delay).masked_fill(lost, math.inf).tolist()

    def _lost(self, device: Tensor, episode: Tensor, slot: Tensor) -> Tensor:
        if self.downlink:
            return uniform(self.seed, "downlink_loss", device, episode, slot) < self.loss.probability
        probability = self.loss.loss_probability(torch.zeros_like(slot, dtype=torch.bool))
        return erased(probability, self.seed, device, episode, slot)
