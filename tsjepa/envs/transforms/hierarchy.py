"""The controller's belief between updates where its predictor has several strides."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import SlotTransform, Values, active_rows, flag_spec, number_spec, require_key, select
from tsjepa.envs.weights import at_weights
from tsjepa.models.hierarchy import HierarchicalPredictor


class HierarchicalEstimator(SlotTransform):
    """Keeps ``belief``: the received embedding where one arrived, else where the strides lead from the last one.

    The largest stride that ends in a slot makes that slot's prediction. Reads ``received`` (or another key),
    ``delivered`` and ``action`` as the :class:`~tsjepa.envs.transforms.estimator.Estimator` does, and writes
    ``belief``, ``informed``, and what the strides need: ``belief_trail``, ``recent_commands`` and ``predicted_slots``.
    A device that was never heard is predicted from zeros, as there.

    Args:
        predictor: with its strides; run without gradients.
        in_key: what arrives.
    """

    carried = ("belief", "informed", "belief_trail", "recent_commands", "predicted_slots")
    previous_keys = ("action",)

    def __init__(self, predictor: HierarchicalPredictor, in_key: str = "received") -> None:
        super().__init__(in_keys=[in_key], out_keys=[*self.carried])
        self.advance = at_weights(predictor, predictor.advance)
        self.strides = predictor.strides

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        size = self._source(incoming).shape[incoming.ndim :]
        action = self.parent.action_spec.shape[incoming.ndim :]
        return {
            "belief": number_spec(incoming, *size),
            "informed": flag_spec(incoming),
            "belief_trail": number_spec(incoming, len(self.strides), *size),
            "recent_commands": number_spec(incoming, self.strides[-1], *action),
            "predicted_slots": number_spec(incoming, dtype=torch.int64),
        }

    def _begin(self, before: Values, current: TensorDictBase) -> Values:
        shape, device = current.batch_size, current.device
        size = self._source(current).shape[-1]
        action = self.parent.action_spec.shape[-1]
        return {
            "belief": torch.zeros(*shape, size, device=device),
            "informed": torch.zeros(shape, dtype=torch.bool, device=device),
            "belief_trail": torch.zeros(*shape, len(self.strides), size, device=device),
            "recent_commands": torch.zeros(*shape, self.strides[-1], action, device=device),
            "predicted_slots": torch.zeros(shape, dtype=torch.int64, device=device),
        }

    def _source(self, container: Composite | TensorDictBase) -> TensorSpec | Tensor:
        return require_key(container, self.in_keys[0], "HierarchicalEstimator", "an Uplink (or set in_key)")

    @torch.no_grad()
    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        trail, commands, slots = (previous[key] for key in self.carried[2:])
        if fresh is None:
            newest = previous["action"].to(torch.float32).unsqueeze(-2)
            commands, slots = torch.cat((commands[..., 1:, :], newest), -2), slots + 1
            trail = self.advance(trail, commands, slots).to(torch.float32)
        delivered = active_rows(current, "delivered", None)
        received = self._source(current).to(torch.float32).unsqueeze(-2).expand_as(trail)
        trail = select(delivered, received, trail)
        return {
            "belief": trail[..., 0, :],
            "informed": previous["informed"] | delivered,
            "belief_trail": trail,
            "recent_commands": commands,
            "predicted_slots": slots.masked_fill(delivered, 0),
        }
