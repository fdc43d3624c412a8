"""The controller's belief between updates, and the actuator's command between commands."""

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import (
    SlotTransform,
    Values,
    active_rows,
    flag_spec,
    number_spec,
    require_key,
    select,
)


class Estimator(SlotTransform):
    """Keeps ``belief``: the received value where one arrived, else the prediction from the last belief and command.

    Reads ``received`` (or another key), ``delivered`` (every row, if nobody wrote it) and the ``action`` that the plant
    was given, so behind a :class:`HoldCommand` the command that was really applied. Writes ``belief`` and ``informed``
    (whether anything has arrived in this episode). With a ``horizon`` also reads ``packet_delay``: a value that is some
    slots old is first predicted up to this slot, through the commands since.

    Args:
        predict: (belief [*B, d], action [*B, m]) -> belief one slot later; a module or any callable, run without
            gradients. ``linear_model`` makes one.
        in_key: what arrives.
        blend: weight of a received value against the prediction; below 1 the two are mixed, except for the first value
            of an episode, which is always taken as it is.
        unit_length: bring what was mixed back to unit length, as embeddings have it.
        initial: belief before anything has arrived, a number or a tensor [d].
        horizon: slots by which a value can be late, as of :class:`Delay`; 0 for values of this slot.
    """

    previous_keys = ("action",)

    def __init__(
        self,
        predict: nn.Module | Callable[[Tensor, Tensor], Tensor],
        in_key: str = "received",
        blend: float = 1.0,
        unit_length: bool = False,
        initial: float | Tensor = 0.0,
        horizon: int = 0,
    ):
        if not 0.0 < blend <= 1.0:
            raise ValueError(f"blend {blend:g} must lie in (0, 1]")
        self.carried = ("belief", "informed") + (("command_history",) if horizon else ())
        super().__init__(in_keys=[in_key], out_keys=[*self.carried])
        self.horizon = horizon
        self.predict = predict
        self.blend, self.unit_length = blend, unit_length
        self.register_buffer("initial", torch.as_tensor(initial, dtype=torch.float32))

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        spec = self._source(incoming)
        specs = {"belief": number_spec(incoming, *spec.shape[incoming.ndim :]), "informed": flag_spec(incoming)}
        if self.horizon:
            size = self.parent.action_spec.shape[incoming.ndim :]
            specs["command_history"] = number_spec(incoming, self.horizon, *size)
        return specs

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        shape = self._source(current).shape
        start = {
            "belief": self.initial.to(current.device).expand(shape).clone(),
            "informed": torch.zeros(current.batch_size, dtype=torch.bool, device=current.device),
        }
        if self.horizon:
            rest = torch.zeros(self.parent.action_spec.shape, device=current.device)
            start["command_history"] = rest.unsqueeze(-2).repeat_interleave(self.horizon, -2)
        return start

    def _source(self, container: Composite | TensorDictBase) -> TensorSpec | Tensor:
        return require_key(container, self.in_keys[0], "Estimator", "an Uplink (or set in_key)")

    @torch.no_grad()
    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        received = self._source(current).to(torch.float32)
        delivered = active_rows(current, "delivered", None)
        belief = previous["belief"]
        if fresh is None:
            belief = self.predict(belief, previous["action"]).to(torch.float32)
        values = {}
        if self.horizon:
            history = previous["command_history"]
            if fresh is None:
                newest = previous["action"].to(torch.float32).unsqueeze(-2)
                history = torch.cat((history[..., 1:, :], newest), -2)
            values["command_history"] = history
            received = self._brought_up(received, history, current)
        taken = received
        if self.blend < 1.0:
            mixed = torch.lerp(belief, received, self.blend)
            mixed = nn.functional.normalize(mixed, dim=-1) if self.unit_length else mixed
            taken = select(previous["informed"], mixed, received)
        return values | {"belief": select(delivered, taken, belief), "informed": previous["informed"] | delivered}

    def _brought_up(self, received: Tensor, history: Tensor, current: TensorDictBase) -> Tensor:
        """What arrived, predicted through the commands ``history`` [*B, horizon, m], newest last, since it was sent."""
        late = require_key(current, "packet_delay", "Estimator with a horizon", "a Delay")
        for slots in range(int(late.max()), 0, -1):
            received = select(late >= slots, self.predict(received, history[..., -slots, :]), received)
        return received.to(torch.float32)


def linear_model(a: Tensor, b: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
    """The prediction x' = A x + B u for rows of x [*B, n] and u [*B, m], with A [n, n] and B [n, m].

    Of several A [kinds, n, n] and B [kinds, n, m], device i, the last dimension of B, has those of ``i % kinds``.
    """
    if a.ndim == 3:
        return lambda belief, action: sum(
            (matrix[torch.arange(rows.shape[-2]) % len(matrix)].to(rows) @ rows.unsqueeze(-1)).squeeze(-1)
            for matrix, rows in ((a, belief), (b, action))
        )

    def predict(belief: Tensor, action: Tensor) -> Tensor:
        return belief @ a.to(belief).mT + action @ b.to(belief).mT

    return predict


class HoldCommand(SlotTransform):
    """The last command is repeated, or the one at rest given, while no update of its device arrives.

    Replaces ``action`` on its way to the plant where ``delivered`` is False; the policy's own action stays in the
    tensordict. Writes ``held_command`` [*B, m], the command of the slot before, at rest at the start. Behind a downlink
    it is the one that was sent: what was applied may be an older one.

    Put it last: what stands before it then sees the command that was applied.

    Args:
        between: "hold" repeats the last command (the paper's baselines 4 and 5), "zero" rests.
        rest: the command [m] at rest.
    """

    carried = ("held_command",)

    def __init__(self, between: str = "hold", rest: float | Tensor = 0.0):
        if between not in ("hold", "zero"):
            raise ValueError(f"unknown between {between!r}: choose 'hold' or 'zero'")
        super().__init__(in_keys=[], out_keys=["held_command"])
        self.between = between
        self.register_buffer("rest", torch.as_tensor(rest, dtype=torch.float32))

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        require_key(incoming, "delivered", "HoldCommand", "an Uplink")
        return {"held_command": number_spec(incoming, *self.parent.action_spec.shape[incoming.ndim :])}

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        return {"held_command": self.rest.to(current.device).expand(self.parent.action_spec.shape).clone()}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        require_key(current, "delivered", "HoldCommand", "an Uplink")
        return {"held_command": previous["held_command"]}

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        command = tensordict["action"]
        held = tensordict["held_command"].to(command) if self.between == "hold" else self.rest.expand_as(command)
        command = select(tensordict["delivered"], command, held)
        return tensordict.set("held_command", command.to(torch.float32)).set("action", command)
