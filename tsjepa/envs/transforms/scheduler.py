"""Who transmits in this slot."""

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, flag_spec, number_spec, require_key
from tsjepa.radio.belief import PredictedCsi, make_belief
from tsjepa.radio.decoding import Decoding
from tsjepa.radio.knowledge import Known
from tsjepa.radio.link import DECODE_THRESHOLD_DB, db_to_linear, resource_units, units_per_slot
from tsjepa.radio.links import AdaptedDecoding
from tsjepa.radio.loss import GilbertElliott, IidLoss
from tsjepa.radio.own_scheduler import checked
from tsjepa.radio.schedulers import SchedulerFunction, get_scheduler


class Scheduler(SlotTransform):
    """Runs a scheduler over the devices, the last batch dimension, and writes ``scheduled``.

    Either each device takes one of ``resource_blocks`` (the paper's J), or devices that send ``payload_bits`` take as
    many resource units as their channel needs out of the ``units`` in a slot; then ``resource_units`` says how many
    were granted. Devices that reset in the middle of a slot share what the others have left of it.

    Reads ``snr`` and ``mean_snr`` where a :class:`Channel` wrote them, age and outcome of the slot before where an
    :class:`Uplink` did, and ``slot`` where the plant counts the slots of its episodes; without them links are perfect,
    ages are 1, and a scheduler that needs the slot says so. ``urgency``, ``expected_gain``, ``true_error``,
    ``signalling_bits`` and ``weight`` are handed on where something writes them. ``channel_belief`` is what the
    scheduler remembers of each link; the hidden state of a loss model is not read, it is inferred from the outcomes.

    Args:
        scheduler: a name in ``SCHEDULERS``, or a function of that interface.
        resource_blocks: J, devices per slot.
        payload_bits: bits per update, instead of ``resource_blocks``; a number, or one a device [I].
        units: resource units in a slot; None derives them from ``sampling_interval``.
        sampling_interval: seconds per slot.
        csi: "perfect", "delayed" (by ``csi_delay`` slots), "statistical" (mean SNR), or "acks" (nothing but outcomes).
        csi_delay: slots by which delayed knowledge lags.
        snr_threshold_db: decode threshold. With perfect CSI a device asks for units at its SNR (or at the threshold,
            if that is higher); otherwise at the threshold, so that it arrives if and only if the threshold is met.
        max_doppler_hz, loss, fading: the channel that the scheduler assumes, as of :class:`Channel`.
        decoding: when a packet is decoded, if not from the threshold on.
        demand: from bits and linear SNR to the resource units that a device asks for.
        outcome_keys: outcome and age of the slot before, as whoever schedules knows them.
        weight: priority of each device [I], unless something writes ``weight``.
    """

    def __init__(
        self,
        scheduler: str | SchedulerFunction = "channel_aware",
        resource_blocks: int | None = None,
        payload_bits: int | Tensor | None = None,
        units: int | None = None,
        sampling_interval: float = 0.02,
        csi: str = "perfect",
        csi_delay: int = 1,
        snr_threshold_db: float = DECODE_THRESHOLD_DB,
        max_doppler_hz: float = 0.0,
        loss: IidLoss | GilbertElliott | None = None,
        fading: str = "rayleigh",
        decoding: Decoding | AdaptedDecoding | None = None,
        demand: Callable[[Any, Tensor], Tensor] = resource_units,
        outcome_keys: tuple[str, str] = ("delivered", "age_of_information"),
        weight: Tensor | None = None,
    ):
        if (resource_blocks is None) == (payload_bits is None):
            raise ValueError("give either resource_blocks (devices per slot) or payload_bits (bits per update)")
        carried = ["scheduled", "scheduler_memory", "channel_belief"]
        if payload_bits is not None:
            carried.append("resource_units")
        self.carried = tuple(carried)
        super().__init__(in_keys=[], out_keys=carried)
        self.decide = checked(get_scheduler(scheduler))
        self.payload_bits = payload_bits
        self.budget = resource_blocks if payload_bits is None else (units or units_per_slot(sampling_interval))
        self.csi, self.weight = csi, weight
        self.snr_threshold = float(db_to_linear(snr_threshold_db))
        decided: Any = self.snr_threshold if decoding is None else decoding
        self.belief = make_belief(csi, decided, csi_delay, loss, max_doppler_hz, sampling_interval, fading)
        self.demand, self.outcome_keys, self.previous_keys = demand, outcome_keys, outcome_keys

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        specs = {"scheduled": flag_spec(incoming), "scheduler_memory": number_spec(incoming, dtype=torch.float64)}
        if self.payload_bits is not None:
            specs["resource_units"] = number_spec(incoming, dtype=torch.int64)
        specs["channel_belief"] = number_spec(incoming, self.belief.width, dtype=torch.float64)
        return specs

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        shape, device = current.batch_size, current.device
        # the memory belongs to the scheduler, not to the episode
        memory = before.get("scheduler_memory", torch.zeros(shape, dtype=torch.float64, device=device))
        start = {"scheduler_memory": memory, "scheduled": torch.zeros(shape, dtype=torch.bool, device=device)}
        start["resource_units"] = torch.zeros(shape, dtype=torch.int64, device=device)
        belief = before.get("channel_belief", None)
        start["channel_belief"] = self.belief.start(shape, device) if belief is None else self.belief.restart(belief)
        return start

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        belief, known = self._knowledge(previous, current)
        if self.payload_bits is not None:
            known = known._replace(demand=self._demand(known, current))
        if fresh is not None and not bool(fresh.all()):
            taken = previous["scheduled"] if known.demand is None else previous["resource_units"]
            left = known.budget - taken.masked_fill(fresh, 0).sum(-1)
            known = known._replace(candidate=fresh, budget=left)
        schedule, memory = self.decide(known)
        values = {"scheduled": schedule, "scheduler_memory": memory, "channel_belief": belief}
        if known.demand is not None:
            values["resource_units"] = known.demand.masked_fill(~schedule, 0)
        return values

    def _knowledge(self, previous: Values, current: TensorDictBase) -> tuple[Tensor, Known]:
        """What is remembered of the links, and what is known of this slot."""
        shape, device = current.batch_size, current.device
        everyone = torch.ones(shape, dtype=torch.bool, device=device)
        perfect = torch.ones(shape, dtype=torch.float64, device=device)
        delivered, age = (previous[key] for key in self.outcome_keys)
        belief = previous["channel_belief"]
        known = Known(
            age=torch.ones(shape, dtype=torch.int64, device=device) if age is None else age,
            snr=perfect,
            success=perfect,
            above_threshold=everyone,
            candidate=everyone,
            budget=self.budget,
            memory=previous["scheduler_memory"],
            weight=current.get("weight", self.weight),
            signalling_bits=current.get("signalling_bits", 0),
            **{key: current.get(key, None) for key in ("urgency", "expected_gain", "true_error", "age_cost", "slot")},
        )
        if current.get("snr", None) is None:
            return belief, known
        # without an Uplink, and in the first slot of an episode, there is no outcome to learn from
        arrived = ~everyone if delivered is None else delivered
        sent = ~everyone if delivered is None else previous["scheduled"]
        gains = {"gain": current.get("gain", None)} if isinstance(self.belief, PredictedCsi) else {}
        belief, link = self.belief.step(belief, current["mean_snr"], current["snr"], sent, arrived, **gains)
        return belief, known._replace(**link._asdict())

    def _demand(self, known: Known, current: TensorDictBase) -> Tensor:
        require_key(current, "snr", "Scheduler with payload_bits", "a Channel")
        snr = known.snr if self.csi == "perfect" else torch.zeros_like(known.snr)
        return self.demand(self.payload_bits, snr.clamp(min=self.snr_threshold))
