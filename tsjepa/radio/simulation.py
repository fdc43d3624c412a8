"""Pure network mode: many slots of channel, scheduler and uplink, without a plant."""

from typing import NamedTuple

import torch
from torch import Tensor

from tsjepa.radio.belief import check_csi
from tsjepa.radio.feedback import AckLearned
from tsjepa.radio.knowledge import Known
from tsjepa.radio.link import DECODE_THRESHOLD_DB, db_to_linear
from tsjepa.radio.own_scheduler import checked
from tsjepa.radio.schedulers import SchedulerFunction, get_scheduler

_CHUNK_ELEMENTS = 2**18


class AgeTrace(NamedTuple):
    """Outcome of :func:`simulate_ages`, for B repetitions of I devices over K slots.

    Attributes:
        mean_age: [K, B] float64, age averaged over the devices in each slot.
        age: [B, I] int64, age in the last slot.
        grants, deliveries: [B, I] int64, how often each device transmitted, and arrived.
    """

    mean_age: Tensor
    age: Tensor
    grants: Tensor
    deliveries: Tensor


def simulate_ages(
    scheduler: str | SchedulerFunction,
    num_devices: int,
    resource_blocks: int,
    slots: int,
    *,
    mean_snr_db: Tensor | float = 10.0,
    snr_threshold_db: float = DECODE_THRESHOLD_DB,
    csi: str = "perfect",
    aoi_reset: str = "delivery",
    batch: int = 1,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> AgeTrace:
    """Run ``batch`` independent networks under independent Rayleigh block fading.

    The channel depends on the seed and the sizes only: two schedulers that are run with the same ones see the same.

    Args:
        scheduler: a name in ``SCHEDULERS`` or a function of that interface.
        num_devices, resource_blocks, slots: I, J and K.
        mean_snr_db: mean SNR, a number or one per device [I].
        snr_threshold_db: SNR at which a packet is decoded.
        csi: "perfect" (this slot's SNR), "statistical" (its mean), "acks" (learned from acknowledgements alone), or
            "delayed", which is the same as "statistical" here: independent fading keeps nothing of an older slot.
        aoi_reset: "delivery", or "scheduled" for the age as printed.
        batch: number of repetitions B.
        seed: seed of the fading.
        device: where to run.
    """
    check_csi(csi, csi_delay=1)
    if aoi_reset not in ("delivery", "scheduled"):
        raise ValueError(f"unknown aoi_reset {aoi_reset!r}: choose 'delivery' or 'scheduled'")
    if not 1 <= slots < 2**24:
        raise ValueError(f"slots = {slots} must lie between 1 and 2^24 - 1")
    decide = checked(get_scheduler(scheduler))
    shape = (batch, num_devices)
    generator = torch.Generator(device=device).manual_seed(seed)
    mean_snr = db_to_linear(mean_snr_db).to(device, torch.float32).expand(shape)
    threshold = float(db_to_linear(snr_threshold_db))
    # float32 counts exactly up to 2^24 and spares every score a conversion
    age = torch.ones(shape, device=device)
    everyone = torch.ones(shape, dtype=torch.bool, device=device)
    memory = torch.zeros(shape, dtype=torch.float64, device=device)
    known_snr, success, above = mean_snr, torch.exp(-threshold / mean_snr), everyone
    learner = AckLearned(threshold) if csi == "acks" else None
    learned = learner and learner.start(shape, device)
    schedule = delivered = torch.zeros_like(everyone)
    grants, deliveries = _Counter(shape, device), _Counter(shape, device)
    mean_age = torch.zeros((slots, batch), dtype=torch.float64, device=device)
    draws = torch.empty((max(1, _CHUNK_ELEMENTS // (batch * num_devices)), *shape), device=device)

    for first in range(0, slots, draws.shape[0]):
        chunk = _draw_snr(draws[: slots - first], mean_snr, generator)
        clock = torch.arange(first, first + len(chunk), device=device)
        for snr, slot, mean in zip(chunk.unbind(), clock.unbind(), mean_age[first:], strict=False):
            decodable = snr >= threshold
            if csi == "perfect":
                known_snr, success, above = snr, decodable.to(snr.dtype), decodable
            elif learner is not None:
                learned, (known_snr, success, above) = learner.step(learned, mean_snr, snr, schedule, delivered)
            # no name for it: it would keep the age of the slot before alive, and with it the cache's lines
            schedule, memory = decide(
                Known(age, known_snr, success, above, everyone, resource_blocks, memory, slot=slot)
            )
            delivered = schedule & decodable
            age = torch.where(delivered if aoi_reset == "delivery" else schedule, 1.0, age.add_(1.0))
            grants.add(schedule)
            deliveries.add(delivered)
            mean.copy_(age.mean(-1))
    return AgeTrace(mean_age, age.to(torch.int64), grants.total(), deliveries.total())


class _Counter:
    """Counts how often each flag was set, in bytes that are emptied before they overflow: adding bytes is cheap."""

    def __init__(self, shape: tuple[int, ...], device: torch.device | str):
        self.sum = torch.zeros(shape, dtype=torch.int64, device=device)
        self.bytes = torch.zeros(shape, dtype=torch.uint8, device=device)
        self.pending = 0

    def add(self, flags: Tensor) -> None:
        self.bytes.add_(flags.view(torch.uint8))
        self.pending += 1
        if self.pending == 255:
            self.total()

    def total(self) -> Tensor:
        self.sum.add_(self.bytes)
        self.bytes.zero_()
        self.pending = 0
        return self.sum


def _draw_snr(out: Tensor, mean_snr: Tensor, generator: torch.Generator) -> Tensor:
    # the logarithm of a uniform is several times faster here than Tensor.exponential_
    return out.uniform_(generator=generator).neg_().log1p_().neg_().mul_(mean_snr)
