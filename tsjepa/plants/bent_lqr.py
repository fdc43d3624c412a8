"""A clipped regulator with saturating terms beside it: the form of a law that is searched for."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from tsjepa.plants.lqr import ClippedLQR


class BentLQR(ClippedLQR):
    """u = -K (clip(e_0), e_1, ...) + sum_j a_j tanh(w_j e) of the error e, odd as machines with a mirror symmetry want.

    Args:
        gain, position_clip, action_low, action_high: as of :class:`tsjepa.plants.lqr.ClippedLQR`.
        directions: w [h, n], per unit of the state.
        heights: a [m, h], in the command's unit.
    """

    def __init__(
        self,
        gain: Tensor | Sequence[Sequence[float]],
        position_clip: float,
        action_low: Sequence[float],
        action_high: Sequence[float],
        directions: Tensor | Sequence[Sequence[float]],
        heights: Tensor | Sequence[Sequence[float]],
    ) -> None:
        super().__init__(gain, position_clip, action_low, action_high)
        self.register_buffer("directions", torch.as_tensor(directions, dtype=torch.float64))
        self.register_buffer("heights", torch.as_tensor(heights, dtype=torch.float64))

    def unsaturated(self, state: Tensor, reference: Tensor | None = None) -> Tensor:
        """As of the regulator."""
        error = self.error(state, reference)
        bends = torch.tanh(error @ self.directions.to(error).mT)
        return super().unsaturated(error) + bends @ self.heights.to(error).mT
