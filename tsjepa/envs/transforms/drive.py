"""Somebody else at the wheel: the plant gets an expert's command, and the rest of the chain the policy's own."""

from __future__ import annotations

from tensordict import TensorDictBase
from torch import nn
from torchrl.envs.transforms import Transform


class Drive(Transform):
    """The plant obeys an expert that is told the true state, whatever the policy commands.

    Put it first in the chain: what stands behind it, such as an estimator that predicts, then sees the policy's own
    command, as if the plant had obeyed it. So a policy can be compared with the expert in states that it has not
    brought about itself.

    Args:
        expert: from states [*B, n] and set-points [*B, r] (or None) to commands [*B, m].
    """

    def __init__(self, expert: nn.Module) -> None:
        super().__init__()
        self.expert = expert

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        own = tensordict["action"]
        driven = self.expert(tensordict["state"], tensordict.get("reference", None)).to(own)
        return tensordict.set("own_action", own).set("action", driven)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        tensordict.set("action", tensordict.pop("own_action"))
        return next_tensordict
