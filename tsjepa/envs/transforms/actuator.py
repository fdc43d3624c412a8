"""The downlink: commands that are late or lost, and the buffer that the actuator plays meanwhile."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, number_spec, require_key, select
from tsjepa.envs.transforms.channel import device_index
from tsjepa.envs.transforms.delay import episode_of
from tsjepa.radio.delay import DelayLaw, InFlight, nothing_in_flight, receive, send, whole_slots
from tsjepa.radio.streams import uniform


class Actuator(SlotTransform):
    """Gives the plant the command that the newest packet of the downlink has for this slot.

    A packet holds commands for the slot in which it was sent and the ``buffer`` - 1 slots after it (packetised
    predictive control: Quevedo and Nesic, 2011). When they are used up the last one is held; until the first packet the
    actuator rests. With ``buffer`` 1 that is an actuator that holds.

    Replaces ``action`` on its way to the plant. Reads ``plan`` [*B, buffer, m] from the policy where ``buffer`` exceeds
    1, its first row the ``action``. Writes ``applied_command`` [*B, m], what was applied in the slot before, at rest at
    the start. Put it in front of the estimator, which then sees what the last packet that was sent has for the slot, or
    if ``acknowledged`` what was applied.

    Args:
        loss: probability that a packet is lost.
        delay: law of the delays, or None.
        every: the controller sends in every so many slots of an episode.
        buffer: commands in a packet.
        acknowledged: the controller is told what was applied.
        horizon: slots; what would travel as long or longer is lost.
        rest: the command [m] at rest.
        sampling_interval: seconds per slot.
        seed: of losses and delays.
    """

    carried = (
        "command_flight",
        "command_flight_slot",
        "command_buffer",
        "command_slot",
        "applied_command",
        "sent_buffer",
        "sent_slot",
    )

    def __init__(
        self,
        loss: float = 0.0,
        delay: DelayLaw | None = None,
        every: int = 1,
        buffer: int = 1,
        acknowledged: bool = False,
        horizon: int = 16,
        rest: float | Tensor = 0.0,
        sampling_interval: float = 0.02,
        seed: int = 0,
    ):
        super().__init__(in_keys=[], out_keys=[*self.carried])
        self.loss, self.delay, self.every, self.buffer = loss, delay, every, buffer
        self.acknowledged, self.horizon = acknowledged, 1 if delay is None else horizon
        self.sampling_interval, self.seed = sampling_interval, seed
        self.register_buffer("rest", torch.as_tensor(rest, dtype=torch.float32))

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        require_key(incoming, "slot", "Actuator", "a plant that counts its slots")
        size = self.parent.action_spec.shape[incoming.ndim :]
        whole = {"dtype": torch.int64}
        return {
            "command_flight": number_spec(incoming, self.horizon, self.buffer, *size),
            "command_flight_slot": number_spec(incoming, self.horizon, **whole),
            "command_buffer": number_spec(incoming, self.buffer, *size),
            "command_slot": number_spec(incoming, **whole),
            "applied_command": number_spec(incoming, *size),
            "sent_buffer": number_spec(incoming, self.buffer, *size),
            "sent_slot": number_spec(incoming, **whole),
        }

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        rest = self.rest.to(current.device).expand(self.parent.action_spec.shape).clone()
        buffer = rest.unsqueeze(-2).repeat_interleave(self.buffer, -2)
        flight = nothing_in_flight(tuple(current.batch_size), self.horizon, buffer)
        return {
            "command_flight": flight.payload,
            "command_flight_slot": flight.sequence,
            "command_buffer": buffer,
            "command_slot": torch.full(current.batch_size, -1, dtype=torch.int64, device=current.device),
            "applied_command": rest,
            "sent_buffer": buffer.clone(),
            "sent_slot": torch.full(current.batch_size, -1, dtype=torch.int64, device=current.device),
        }

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        return {key: previous[key] for key in self.carried}

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        slot, device, episode = tensordict["slot"], device_index(tensordict), episode_of(tensordict)
        flight = InFlight(tensordict["command_flight"], tensordict["command_flight_slot"])
        arrives = uniform(self.seed, "downlink_loss", device, episode, slot) >= self.loss
        due = slot % self.every == 0
        delay = torch.zeros_like(slot)
        if self.delay is not None:
            drawn = self.delay.draw(self.seed, device, episode, slot, stream="downlink_delay")
            delay = whole_slots(drawn, self.delay.unit, self.sampling_interval)
        packet = self._packet(tensordict)
        sent_buffer = select(due, packet, tensordict["sent_buffer"])
        sent_slot = torch.where(due, slot, tensordict["sent_slot"])
        flight, _ = send(flight, arrives & due, packet, slot, delay)
        flight, heard, packet, number = receive(flight)
        newest = tensordict["command_slot"]
        newer = heard & (number > newest)
        newest = torch.where(newer, number, newest)
        buffer = select(newer, packet, tensordict["command_buffer"])
        applied, action = self._command_of(buffer, slot - newest), tensordict["action"]
        values = (flight.payload, flight.sequence, buffer, newest, applied, sent_buffer, sent_slot)
        for key, value in zip(self.carried, values, strict=True):
            tensordict.set(key, value)
        believed = self._command_of(sent_buffer, slot - sent_slot)
        return tensordict.set("sent_command", believed.to(action)).set("action", applied.to(action))

    def _command_of(self, buffer: Tensor, slots_ago: Tensor) -> Tensor:
        """What a packet [*B, buffer, m] that was sent so many slots ago has for this slot, [*B, m]."""
        place = slots_ago.clamp(max=self.buffer - 1)
        index = place.reshape(*place.shape, 1, 1).expand(*place.shape, 1, buffer.shape[-1])
        return buffer.gather(-2, index).squeeze(-2)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        sent = tensordict.pop("sent_command")
        if not self.acknowledged:
            tensordict.set("action", sent)
        return super()._step(tensordict, next_tensordict)

    def _packet(self, tensordict: TensorDictBase) -> Tensor:
        if self.buffer == 1:
            return tensordict["action"].to(torch.float32).unsqueeze(-2)
        plan = require_key(tensordict, "plan", "Actuator with a buffer", "a policy that plans (make_policy)")
        if plan.shape[-2] != self.buffer:
            raise ValueError(f"the plan has {plan.shape[-2]} commands, and a packet holds {self.buffer}")
        return plan.to(torch.float32)
