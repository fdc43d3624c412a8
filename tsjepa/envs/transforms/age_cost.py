"""What its age costs a plant: the table's entry of each device, and nothing of a device that has fallen."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, flag_spec, number_spec, require_key
from tsjepa.radio.cost import age_cost


class AgeCost(SlotTransform):
    """Writes ``age_cost`` [*B] float64, the plant's own cost of the age at which each device is known.

    A device whose last update showed that it had failed gives up its claim, and costs 0 until an update shows a state
    that has not. Put it before the Scheduler.

    Args:
        heard: cost at the ages 0, 1, ... since an update, [I, ages] or [ages].
        unheard: the same of a device that was not heard in its episode, whose age is counted from the start.
        failed: from what is received [*B, d] to [*B] bool, beyond recovery.
        in_key: what arrives: "received", or "embedding" where the controller encodes frames.
        age_key: the age as whoever schedules knows it.
    """

    carried = ("given_up",)

    def __init__(
        self,
        heard: Tensor,
        unheard: Tensor,
        failed: Callable[[Tensor], Tensor],
        in_key: str = "received",
        age_key: str = "age_of_information",
    ):
        self.previous_keys = ("delivered", in_key, age_key)
        super().__init__(in_keys=["slot"], out_keys=["age_cost", *self.carried])
        self.heard, self.unheard, self.failed = heard, unheard, failed
        self.received, self.age_key = in_key, age_key

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        self._counted(incoming)
        return {"age_cost": number_spec(incoming, dtype=torch.float64), "given_up": flag_spec(incoming)}

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        return {"given_up": torch.zeros(current.batch_size, dtype=torch.bool, device=current.device)}

    @torch.no_grad()
    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        delivered, age, given_up = previous["delivered"], previous[self.age_key], previous["given_up"]
        slot = self._counted(current)
        age = torch.ones_like(slot) if age is None else age
        if delivered is not None:
            given_up = torch.where(delivered, self.failed(previous[self.received]), given_up)
        # an age counts from 1 in slot 0, so it is larger than the slot's number as long as nothing has arrived
        cost = torch.where(age > slot, age_cost(self.unheard, age), age_cost(self.heard, age))
        return {"age_cost": cost.masked_fill(given_up, 0.0), "given_up": given_up}

    @staticmethod
    def _counted(container: Composite | TensorDictBase) -> TensorSpec | Tensor:
        return require_key(container, "slot", "AgeCost", "a fleet of plants")
