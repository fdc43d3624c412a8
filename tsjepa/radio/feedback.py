"""What acknowledgements tell: a filter of hidden loss states, and success rates that are learned from nothing else.

The base station receives the updates, so it knows the outcome of every transmission. Pure functions of tensors with I
devices on the last dimension and any batch before it; ``sent`` and ``arrived`` are bool of that shape.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from tsjepa.radio.knowledge import Link
from tsjepa.radio.loss import GilbertElliott

_LAGS, _RECORD = 5, 3
CELLS = _LAGS * 2**_RECORD
"""Situations in which success is counted: the last three outcomes, by whether the last was 1, 2, 3-4, 5-8 or more slots
ago."""


def predict_bad(loss: GilbertElliott, bad: Tensor) -> Tensor:
    """P[bad state] one slot later: b (1 - bad_to_good) + (1 - b) good_to_bad."""
    return bad * (1.0 - loss.bad_to_good) + (1.0 - bad) * loss.good_to_bad


def update_bad(loss: GilbertElliott, bad: Tensor, sent: Tensor, arrived: Tensor, decodable: Tensor) -> Tensor:
    """P[bad state] of a slot after its outcome (Bayes' rule); unchanged where nothing was sent.

    Args:
        loss: the chain, its parameters known.
        bad: P[bad] before the outcome.
        sent, arrived: what happened in that slot.
        decodable: probability that the SNR sufficed: 1 after a NACK says that the packet was erased, 0 that it says
            nothing about the state.
    """
    in_bad, in_good = decodable * (1.0 - loss.loss_bad), decodable * (1.0 - loss.loss_good)
    in_bad, in_good = torch.where(arrived, in_bad, 1.0 - in_bad), torch.where(arrived, in_good, 1.0 - in_good)
    total = bad * in_bad + (1.0 - bad) * in_good
    # an outcome that the model calls impossible changes nothing
    after = torch.where(total > 0, bad * in_bad / total.clamp(min=1e-300), bad)
    return torch.where(sent, after, bad)


def loss_given_bad(loss: GilbertElliott, bad: Tensor) -> Tensor:
    """Probability that a packet is erased, given P[bad state]."""
    return bad * loss.loss_bad + (1.0 - bad) * loss.loss_good


class AckCounts(NamedTuple):
    """Outcomes, counted by the situation in which a device transmitted.

    Attributes:
        acks, sends: [..., I, CELLS] float64, discounted counts.
        record: [..., I] int64, the last outcomes of each device as bits, the newest lowest, 1 for an ACK.
        since: [..., I] int64, slots since its last transmission.
    """

    acks: Tensor
    sends: Tensor
    record: Tensor
    since: Tensor


def start_counts(shape: tuple[int, ...], device: torch.device | str = "cpu") -> AckCounts:
    """Nothing counted yet, for devices of ``shape`` [..., I]; who never transmitted counts as one that was heard."""
    empty = torch.zeros((*shape, CELLS), dtype=torch.float64, device=device)
    record = torch.full(shape, 2**_RECORD - 1, dtype=torch.int64, device=device)
    return AckCounts(empty, empty.clone(), record, torch.full_like(record, 2**_LAGS))


def update_counts(counts: AckCounts, sent: Tensor, arrived: Tensor, discount: float = 1.0) -> AckCounts:
    """Counts after a slot's outcome. ``discount`` in (0, 1] forgets: counts of k slots ago weigh discount^k."""
    cell = torch.nn.functional.one_hot(_cell(counts), CELLS) * sent.unsqueeze(-1)
    record = (2 * counts.record + arrived) % 2**_RECORD
    return AckCounts(
        discount * counts.acks + cell * arrived.unsqueeze(-1),
        discount * counts.sends + cell,
        torch.where(sent, record, counts.record),
        torch.where(sent, 1, counts.since + 1),
    )


def learned_success(counts: AckCounts, strength: float = 30.0) -> Tensor:
    """Probability that a transmission in the coming slot arrives, [..., I] float64, from acknowledgements alone.

    It is the fleet's success rate in the situation of the device: nothing is learned of a device but its last outcomes,
    so that no device is written off for ever by bad luck. A Beta prior at the fleet's overall rate, worth ``strength``
    outcomes, stands in for situations that were hardly ever seen.
    """
    acks, sends = counts.acks.sum(-2, keepdim=True), counts.sends.sum(-2, keepdim=True)
    overall = (acks.sum(-1, keepdim=True) + 1.0) / (sends.sum(-1, keepdim=True) + 2.0)
    rate = (acks + strength * overall) / (sends + strength)
    return rate.expand_as(counts.sends).gather(-1, _cell(counts).unsqueeze(-1)).squeeze(-1)


@dataclass(frozen=True)
class AckLearned:
    """Nothing is known but the outcomes of what was sent; everything in ``success`` is counted, losses included.

    Args:
        snr_threshold: linear; ``snr`` is the mean that a Rayleigh link of that success probability would have.
        discount: weight by which a count fades in a slot; 1 never forgets.
        strength: outcomes that the fleet's overall rate is worth in the estimate of a situation.
    """

    snr_threshold: float
    discount: float = 1.0
    strength: float = 30.0

    @property
    def width(self) -> int:
        return 2 * CELLS + 2

    def start(self, shape: tuple[int, ...], device: torch.device | str = "cpu") -> Tensor:
        return _pack(start_counts(shape, device))

    def restart(self, memory: Tensor) -> Tensor:
        fresh = start_counts(memory.shape[:-1], memory.device)
        return _pack(_unpack(memory)._replace(record=fresh.record, since=fresh.since))

    def step(self, memory: Tensor, mean_snr: Tensor, snr: Tensor, sent: Tensor, arrived: Tensor) -> tuple[Tensor, Link]:
        counts = update_counts(_unpack(memory), sent, arrived, self.discount)
        success = learned_success(counts, self.strength)
        expected = self.snr_threshold / -torch.log(success.clamp(1e-12, 1.0 - 1e-12))
        return _pack(counts), Link(expected, success, torch.ones_like(sent))


def _cell(counts: AckCounts) -> Tensor:
    lag = torch.log2(counts.since.to(torch.float64)).ceil().clamp(max=_LAGS - 1).to(torch.int64)
    return counts.record * _LAGS + lag


def _pack(counts: AckCounts) -> Tensor:
    return torch.cat((counts.acks, counts.sends, torch.stack(counts[2:], -1).to(torch.float64)), -1)


def _unpack(memory: Tensor) -> AckCounts:
    acks, sends, rest = memory.split((CELLS, CELLS, 2), -1)
    return AckCounts(acks, sends, *rest.to(torch.int64).unbind(-1))
