"""What a device believes of its own machine, from all that it has seen."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, number_spec, require_key, scatter_rows


class Observe(SlotTransform):
    """Replaces the ``embedding`` of every device by its belief, in every slot: what it sends when it is scheduled.

    Put it behind an :class:`Encode` of all devices, so before the Scheduler. The device knows the command that its
    actuator applied. Carries ``device_belief`` [*B, d].

    Args:
        correct: from the last belief [*B, d], the command since [*B, m] and the embedding [*B, d] to the belief; a
            model's :meth:`tsjepa.models.SemanticController.correct`. Run without gradients.
        begin: from scenes [N, frame_history, s], of devices that start an episode, to their beliefs [N, d]; None takes
            the first embedding as it is.
    """

    carried = ("device_belief",)
    previous_keys = ("action",)

    def __init__(
        self,
        correct: Callable[[Tensor, Tensor, Tensor], Tensor],
        begin: Callable[[Tensor], Tensor] | None = None,
    ):
        super().__init__(in_keys=["embedding"], out_keys=["embedding", "device_belief"])
        self.correct, self.begin = correct, begin

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        seen = self._seen(incoming)
        return {key: number_spec(incoming, seen.shape[-1]) for key in self.out_keys}

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        return {"device_belief": torch.zeros_like(self._seen(current))}

    @torch.no_grad()
    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        belief = self._seen(current)
        if fresh is None:
            belief = self.correct(previous["device_belief"], previous["action"], belief).to(torch.float32)
        elif self.begin is not None:
            scene = require_key(current, "scene", "Observe", "a fleet")
            belief = scatter_rows(fresh, self.begin(scene[fresh]).to(torch.float32))
        return {"embedding": belief, "device_belief": belief}

    def _seen(self, container: Composite | TensorDictBase) -> TensorSpec | Tensor:
        return require_key(container, "embedding", "Observe", "a Camera and an Encode")
