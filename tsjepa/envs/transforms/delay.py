"""Updates that travel for a while after the base station has them, and acknowledgements that get lost."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, flag_spec, number_spec, require_key, select
from tsjepa.envs.transforms.channel import device_index
from tsjepa.envs.transforms.uplink import AT_BASE_STATION
from tsjepa.radio.age import next_age
from tsjepa.radio.delay import DelayLaw, InFlight, acknowledged, nothing_in_flight, receive, send, whole_slots


class Delay(SlotTransform):
    """Brings what the base station has decoded to the controller, some slots later.

    Each update carries the slot of its picture as a sequence number. Updates may overtake each other; one that is older
    than what the controller has is thrown away, and the newer of two that arrive together is kept.

    Reads ``decoded``, ``payload`` and the ``slot`` (and ``episode``) of the plant. Writes ``delivered`` (bool, a newer
    one has arrived), ``received`` (the newest update so far, zeros until the first), ``age_of_information`` (int64,
    1 + the slots since the picture of ``received`` was taken) and ``packet_delay`` (int64, slots that what arrived has
    travelled, 0 elsewhere).

    Args:
        law: of the delays; None reads ``delay_ms``, as a :class:`TraceChannel` writes it.
        horizon: slots; what would travel as long or longer is lost.
        sampling_interval: seconds per slot.
        seed: of the delays.
    """

    carried = ("in_flight", "in_flight_slot", "received", "received_slot", "age_of_information")

    def __init__(self, law: DelayLaw | None, horizon: int = 16, sampling_interval: float = 0.02, seed: int = 0):
        if horizon < 1:
            raise ValueError(f"horizon {horizon} must be at least 1 slot")
        super().__init__(in_keys=["payload"], out_keys=[*self.carried, "delivered", "packet_delay"])
        self.law, self.horizon = law, horizon
        self.sampling_interval, self.seed = sampling_interval, seed

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        payload = require_key(incoming, "payload", "Delay", "a Codec")
        size, dtype = payload.shape[incoming.ndim :], payload.dtype
        whole = {"dtype": torch.int64}
        return {
            "in_flight": number_spec(incoming, self.horizon, *size, dtype=dtype),
            "in_flight_slot": number_spec(incoming, self.horizon, **whole),
            "received": payload.clone(),
            "received_slot": number_spec(incoming, **whole),
            "age_of_information": number_spec(incoming, **whole),
            "delivered": flag_spec(incoming),
            "packet_delay": number_spec(incoming, **whole),
        }

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        payload = require_key(current, "payload", "Delay", "a Codec")
        flight = nothing_in_flight(tuple(current.batch_size), self.horizon, payload)
        never = torch.full(current.batch_size, -1, dtype=torch.int64, device=current.device)
        return {
            "in_flight": flight.payload,
            "in_flight_slot": flight.sequence,
            "received": torch.zeros_like(payload),
            "received_slot": never,
            "age_of_information": torch.ones_like(never),
        }

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        slot = require_key(current, "slot", "Delay", "a plant that counts its slots")
        sent = require_key(current, AT_BASE_STATION[0], "Delay", "an Uplink with keys=AT_BASE_STATION")
        sent = sent if fresh is None else sent & fresh
        flight = InFlight(previous["in_flight"], previous["in_flight_slot"])
        flight, _ = send(flight, sent, current["payload"], slot, self._delay(current))
        flight, heard, payload, taken = receive(flight)
        newest = previous["received_slot"]
        newer = heard & (taken > newest)
        newest = torch.where(newer, taken, newest)
        return {
            "in_flight": flight.payload,
            "in_flight_slot": flight.sequence,
            "received": select(newer, payload, previous["received"]),
            "received_slot": newest,
            "age_of_information": slot - newest + 1,
            "delivered": newer,
            "packet_delay": torch.where(newer, slot - taken, 0),
        }

    def _delay(self, current: TensorDictBase) -> Tensor:
        if self.law is None:
            delay, unit = require_key(current, "delay_ms", "Delay", "a TraceChannel, or give a law"), "ms"
        else:
            episode = episode_of(current)
            delay, unit = self.law.draw(self.seed, device_index(current), episode, current["slot"]), self.law.unit
        return whole_slots(delay, unit, self.sampling_interval)


class Acknowledge(SlotTransform):
    """Acknowledgements to whoever schedules, some of which are lost: what was delivered then counts as lost to it.

    Writes ``acknowledged`` (bool) and ``acknowledged_age`` (int64, 1 when an update is acknowledged, else one more),
    for a :class:`Scheduler` with ``outcome_keys`` :data:`ACKNOWLEDGED`.

    Args:
        loss: probability that an acknowledgement is lost.
        outcome_key: what is acknowledged.
        seed: of the losses.
    """

    carried = ("acknowledged", "acknowledged_age")

    def __init__(self, loss: float, outcome_key: str = "delivered", seed: int = 0):
        if not 0.0 <= loss <= 1.0:
            raise ValueError(f"the probability that an acknowledgement is lost, {loss:g}, must lie in [0, 1]")
        super().__init__(in_keys=[outcome_key], out_keys=[*self.carried])
        self.loss, self.seed = loss, seed

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        return {"acknowledged": flag_spec(incoming), "acknowledged_age": number_spec(incoming, dtype=torch.int64)}

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        age = torch.ones(current.batch_size, dtype=torch.int64, device=current.device)
        return {"acknowledged": torch.zeros_like(age, dtype=torch.bool), "acknowledged_age": age}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        delivered = require_key(current, self.in_keys[0], "Acknowledge", "an Uplink")
        slot = require_key(current, "slot", "Acknowledge", "a plant that counts its slots")
        known = acknowledged(delivered, self.loss, self.seed, device_index(current), episode_of(current), slot)
        return {"acknowledged": known, "acknowledged_age": next_age(previous["acknowledged_age"], known)}


ACKNOWLEDGED = Acknowledge.carried
"""Keys of outcome and age as acknowledgements tell them."""


def episode_of(current: TensorDictBase) -> Tensor:
    """Number of each row's episode [*B], int64; 0 where the plant does not count them."""
    slot = current["slot"]
    return current.get("episode", torch.zeros_like(slot))
