"""Pictures and embeddings, made only for the devices that are going to send them."""

from collections.abc import Callable

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import Composite, TensorSpec

from tsjepa.envs.transforms.base import (
    SlotTransform,
    Values,
    active_rows,
    number_spec,
    require_key,
    scatter_rows,
)

Render = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Camera(SlotTransform):
    """Renders ``frame_stack`` frames, ``frame_spacing`` slots apart, of each scheduled device; zeros for the others.

    Reads ``qpos`` [*B, frame_history, 2] (oldest first), ``colors`` [*B, 2, 3], and ``scheduled`` (all rows if nobody
    wrote it). Writes ``pixels`` uint8 [*B, frame_stack, H, W, 3], oldest frame first.

    Args:
        render: takes qpos [N, 2] and colors [N, 2, 3] (ndarrays), returns uint8 [N, H, W, 3].
        frame_stack: kappa, frames per observation.
        frame_spacing: slots between the frames.
        height, width: size of the frames that ``render`` makes.
    """

    def __init__(
        self, render: Render, frame_stack: int = 2, frame_spacing: int = 2, height: int = 64, width: int = 128
    ):
        if frame_stack < 1 or frame_spacing < 1:
            raise ValueError(f"frame_stack {frame_stack} and frame_spacing {frame_spacing} must be at least 1")
        super().__init__(in_keys=["qpos", "colors"], out_keys=["pixels"])
        self.render = render
        self.frame_stack = frame_stack
        self.frame_spacing = frame_spacing
        self.frame_shape = (height, width, 3)

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        self._first_frame(require_key(incoming, "qpos", "Camera", "a fleet"))
        require_key(incoming, "colors", "Camera", "a fleet")
        # a bounded spec would hold its bounds for every pixel and compare them whenever an environment is built
        return {"pixels": number_spec(incoming, self.frame_stack, *self.frame_shape, dtype=torch.uint8)}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        rows = active_rows(current, "scheduled", fresh)
        history = require_key(current, "qpos", "Camera", "a fleet")
        qpos = history[rows][:, self._first_frame(history) :: self.frame_spacing]
        colors = (
            require_key(current, "colors", "Camera", "a fleet")[rows].unsqueeze(1).expand(-1, self.frame_stack, -1, -1)
        )
        shape = (qpos.shape[0], self.frame_stack, *self.frame_shape)
        if qpos.shape[0] == 0:
            frames = torch.empty(shape, dtype=torch.uint8, device=current.device)
        else:
            pictures = self.render(qpos.flatten(0, 1).cpu().numpy(), colors.flatten(0, 1).cpu().numpy())
            frames = torch.from_numpy(pictures).view(shape).to(current.device)
        return {"pixels": scatter_rows(rows, frames)}

    def _first_frame(self, qpos: TensorSpec | Tensor) -> int:
        """Index of the oldest frame in the history."""
        needed = (self.frame_stack - 1) * self.frame_spacing + 1
        if qpos.shape[-2] < needed:
            raise ValueError(
                f"{self.frame_stack} frames {self.frame_spacing} slots apart need a frame_history of {needed}, "
                f"the fleet keeps {qpos.shape[-2]}"
            )
        return qpos.shape[-2] - needed


class Encode(SlotTransform):
    """Applies a module to the rows that need it and writes its output, zeros for the others.

    On the device's side it encodes frames before they are sent (the defaults). On the controller's side, for a payload
    that is frames, use ``Encode(module, in_key="received", mask_key="delivered")`` behind the :class:`Uplink`.

    Args:
        module: takes [N, ...] of ``in_key``, returns float [N, d]; run without gradients.
        in_key, out_key: what it reads and writes.
        mask_key: rows to encode; all if nobody wrote it.
    """

    def __init__(
        self,
        module: nn.Module | Callable[[Tensor], Tensor],
        in_key: str = "pixels",
        out_key: str = "embedding",
        mask_key: str = "scheduled",
    ):
        super().__init__(in_keys=[in_key], out_keys=[out_key])
        self.module = module
        self.mask_key = mask_key

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        spec = require_key(incoming, self.in_keys[0], "Encode", "the transform that makes it")
        sample = torch.zeros((1, *spec.shape[incoming.ndim :]), dtype=spec.dtype, device=incoming.device)
        return {self.out_keys[0]: number_spec(incoming, self._encode(sample).shape[-1])}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        rows = active_rows(current, self.mask_key, fresh)
        source = require_key(current, self.in_keys[0], "Encode", "the transform that makes it")
        if bool(rows.any()):
            return {self.out_keys[0]: scatter_rows(rows, self._encode(source[rows]))}
        # one blank sample tells the width of the module's output
        blank = self._encode(torch.zeros_like(source.flatten(0, rows.ndim - 1)[:1]))
        return {self.out_keys[0]: scatter_rows(rows, blank[:0])}

    @torch.no_grad()
    def _encode(self, values: Tensor) -> Tensor:
        return self.module(values).to(torch.float32)
