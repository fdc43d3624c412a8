"""How far a device's command would change if its controller heard of it now: as the device says, and as is expected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, flag_spec, number_spec, require_key
from tsjepa.radio import expected_error
from tsjepa.radio.urgency import UrgencyCode

Law = Callable[[Tensor, Tensor | None], Tensor]


@dataclass(frozen=True)
class Twin:
    """What device and controller both know of the controller, so that each can run it in step with the other.

    Args:
        law: from what is received [*B, d] and set-points [*B, r] (or None) to commands [*B, m], as parts of the
            actuator's range.
        failed: from what is received to [*B] bool, beyond recovery.
        predict: the estimator's, see :class:`tsjepa.envs.transforms.estimator.Estimator`; None for a controller whose
            command the actuator holds or leaves out between updates.
        rest: [m], the command at rest, as a part of the actuator's range.
        action_range: [m], the actuator's, in its own units.
        holds: whether the command is held, without ``predict``.
        action_key: of the command that the controller takes for applied: "action", or "sent_command" where an
            :class:`Actuator` gave the plant another one and nobody told the controller.
    """

    law: Law
    failed: Callable[[Tensor], Tensor]
    predict: Callable[[Tensor, Tensor], Tensor] | None
    rest: Tensor
    action_range: Tensor
    holds: bool = False
    action_key: str = "action"

    def reads(self) -> tuple[str, ...]:
        """Keys of the slot before that :meth:`command` needs."""
        return (self.action_key,) if self.predict is None else (self.action_key, "belief", "informed")

    def command(self, previous: Values, current: TensorDictBase) -> tuple[Tensor, Tensor | None]:
        """What the controller will command unless it hears of the device, as parts of the actuator's range [*B, m].

        Also what it believes of the device, None of a held command.
        """
        action, rest = previous[self.action_key], self.rest.to(current.device).expand(*current.batch_size, -1)
        if action is None or (self.predict is None and not self.holds):
            return rest, None
        if self.predict is None:
            return action / self.action_range.to(action), None
        belief = self.predict(previous["belief"], action).to(torch.float32)
        believed = self.law(belief, current.get("reference", None))
        return torch.where(previous["informed"].unsqueeze(-1), believed, rest), belief


def _flag(current: TensorDictBase, value: bool) -> Tensor:
    return torch.full(current.batch_size, value, dtype=torch.bool, device=current.device)


def distance(command: Tensor, other: Tensor) -> Tensor:
    """How far commands [*B, m] are apart, [*B]: the largest of their numbers."""
    return (command - other).abs().amax(-1).to(torch.float64)


class Urgency(SlotTransform):
    """The device compares what it sees with what its controller believes, and asks for radio in a few bits.

    Put it before the Scheduler, and before it whatever makes ``in_key`` of every device. A device knows the commands
    that it was sent and which of its updates arrived, so it can run the controller's estimator itself.

    Writes ``true_error`` [*B] float64, how far the command would change if the controller were told now, as a part of
    the actuator's range; of a device that was never heard, how far from rest; 0 of one that has failed, which gives up
    its claim. ``urgency`` [*B] float64 is what the base station has been told of it: the code's level, ``delay`` slots
    late, and 0 once it knows of an update since. ``signalling_bits`` [*B] int64 are spent by every device in every
    slot, whether it needs anything or not, since its place in the uplink is reserved; with ``first_contact`` until an
    update of its episode has arrived, after which it says nothing. With ``change`` they are spent where something is
    said, and the base station keeps to what it heard last; that all requests are heard is taken for granted.

    Args:
        twin: the controller, as the device knows it.
        in_key: what the device sees: "state" or "embedding".
        code: of a request; None sends the number itself and counts no bits.
        delay: slots from a request to the decision that heeds it.
        first_contact: only devices that were not heard yet make requests.
        change: codes by which a device's urgency has to differ from what it said last, 0 after an update, before it
            says so; a request then names its device. None: every device has a place of its own in every slot.
        outcome_key: whether an update arrived, as the base station knows.

    Raises:
        ValueError: a delay below 0, a change below 1 code, or a change without a code.
    """

    def __init__(
        self,
        twin: Twin,
        in_key: str = "embedding",
        code: UrgencyCode | None = None,
        delay: int = 0,
        first_contact: bool = False,
        change: int | None = None,
        outcome_key: str = "delivered",
    ):
        if delay < 0:
            raise ValueError(f"delay {delay} must be at least 0 slots")
        if change is not None and (code is None or change < 1):
            raise ValueError(f"change {change} must be at least 1 code of a request, and there has to be a code")
        # of the slots on the way, and where only changes are said, at least of the slot before
        self.remembered = max(delay, int(change is not None))
        self.carried = ("urgency_requests",) * (self.remembered > 0) + ("urgency_asks",) * first_contact
        self.first_contact = first_contact
        self.previous_keys = ("delivered", outcome_key, *twin.reads())
        super().__init__(in_keys=[in_key], out_keys=["urgency", "true_error", "signalling_bits", *self.carried])
        self.twin, self.code, self.delay, self.change, self.outcome_key = twin, code, delay, change, outcome_key

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        self._seen(incoming)
        specs = {key: number_spec(incoming, dtype=torch.float64) for key in ("urgency", "true_error")}
        specs["signalling_bits"] = number_spec(incoming, dtype=torch.int64)
        if self.remembered:
            specs["urgency_requests"] = number_spec(incoming, self.remembered, dtype=torch.float64)
        if self.first_contact:
            specs["urgency_asks"] = flag_spec(incoming)
        return specs

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        shape = (*current.batch_size, self.remembered)
        empty = torch.zeros(shape, dtype=torch.float64, device=current.device)
        return {"urgency_requests": empty, "urgency_asks": _flag(current, True)}

    @torch.no_grad()
    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        seen = self._seen(current)
        wanted = self.twin.law(seen, current.get("reference", None))
        error = distance(wanted, self.twin.command(previous, current)[0])
        error = error.masked_fill(self.twin.failed(seen), 0.0)
        delivered, known, asks = previous["delivered"], previous[self.outcome_key], _flag(current, True)
        if self.first_contact:
            asks = previous["urgency_asks"] if delivered is None else previous["urgency_asks"] & ~delivered
        requests = previous["urgency_requests"] if self.remembered else None
        if requests is not None and known is not None:
            requests = requests.masked_fill(known.unsqueeze(-1), 0.0)
        said, bits = self._request(error, asks, requests)
        values = {"true_error": error, "signalling_bits": bits}
        if self.first_contact:
            values["urgency_asks"] = asks
        if requests is not None:
            values["urgency_requests"] = torch.cat((requests[..., 1:], said.unsqueeze(-1)), -1)
        return values | {"urgency": said if requests is None or not self.delay else requests[..., 0]}

    def _request(self, error: Tensor, asks: Tensor, requests: Tensor | None) -> tuple[Tensor, Tensor]:
        """What the base station will know of each device once this slot's requests have reached it, and their bits."""
        if self.code is None:
            return error.masked_fill(~asks, 0.0), torch.zeros_like(asks, dtype=torch.int64)
        said = self.code.decode(self.code.encode(error))
        if requests is not None and self.change is not None:
            heard = requests[..., -1]
            asks = asks & self.code.changed(error, heard, self.change)
            return torch.where(asks, said, heard), self.code.signalling_bits(asks, named=True)
        return said.masked_fill(~asks, 0.0), self.code.signalling_bits(asks)

    def _seen(self, container: Composite | TensorDictBase) -> TensorSpec | Tensor:
        return require_key(container, self.in_keys[0], "Urgency", "a Camera and an Encode")


class ExpectedGain(SlotTransform):
    """The controller's own guess at what hearing of a device would save: no device says anything.

    It learns from what arrives; see :mod:`tsjepa.radio.expected_error`. The record is the controller's, so it outlives
    episodes. Of a device that the controller believes to have failed it expects nothing.

    Put it before the Scheduler. Writes ``expected_gain`` [*B] float64, and carries the record.

    Args:
        twin: the controller.
        in_key: what arrives: "received", or "embedding" where the controller encodes frames.
    """

    carried = ("error_record", "error_situation", "expected_command", "ever_heard")

    def __init__(self, twin: Twin, in_key: str = "received"):
        self.previous_keys = ("delivered", "age_of_information", "reference", in_key, *twin.reads())
        super().__init__(in_keys=[], out_keys=["expected_gain", *self.carried])
        self.twin, self.received = twin, in_key

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        return {
            "expected_gain": number_spec(incoming, dtype=torch.float64),
            "error_record": number_spec(incoming, 2, expected_error.CELLS, dtype=torch.float64),
            "error_situation": number_spec(incoming, dtype=torch.int64),
            "expected_command": number_spec(incoming, len(self.twin.rest)),
            "ever_heard": flag_spec(incoming),
        }

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        shape, device = current.batch_size, current.device
        empty = torch.stack(expected_error.start_record(shape, device), -2)
        return {
            "error_record": before.get("error_record", empty),
            "error_situation": torch.zeros(shape, dtype=torch.int64, device=device),
            "expected_command": self.twin.rest.to(device).expand(*shape, -1),
            "ever_heard": _flag(current, False),
        }

    @torch.no_grad()
    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        record = expected_error.ErrorRecord(*previous["error_record"].unbind(-2))
        heard = previous["ever_heard"]
        if previous["delivered"] is not None:
            record, heard = self._learned(record, previous), heard | previous["delivered"]
        command, belief = self.twin.command(previous, current)
        age = previous["age_of_information"]
        age = torch.ones(current.batch_size, dtype=torch.int64, device=current.device) if age is None else age
        situation = expected_error.situation(age, heard)
        gain = expected_error.expected_gain(record, situation)
        if belief is not None:
            gain = gain.masked_fill(heard & self.twin.failed(belief), 0.0)
        return {
            "expected_gain": gain,
            "error_record": torch.stack(record, -2),
            "error_situation": situation,
            "expected_command": command.to(torch.float32),
            "ever_heard": heard,
        }

    def _learned(self, record: expected_error.ErrorRecord, previous: Values) -> expected_error.ErrorRecord:
        received = previous[self.received]
        told = self.twin.law(received, previous["reference"])
        # what a machine beyond recovery shows is no error of the prediction
        heard = previous["delivered"] & ~self.twin.failed(received)
        error = distance(told, previous["expected_command"])
        return expected_error.learn(record, previous["error_situation"], error, heard)
