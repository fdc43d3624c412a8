"""Pictures and embeddings, made only for the devices that are going to send them."""

from __future__ import annotations

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

Render = Callable[[np.ndarray], np.ndarray]


class Camera(SlotTransform):
    """Renders ``frame_stack`` frames, ``frame_spacing`` slots apart, of each scheduled device; zeros for the others.

    Reads ``scene`` [*B, frame_history, s] (oldest first) and ``scheduled`` (all rows if nobody wrote it). Writes
    ``pixels`` uint8 [*B, frame_stack, H, W, 3], oldest frame first.

    Args:
        render: from scenes [N, s] (an ndarray) to uint8 [N, H, W, 3]; a plant's ``render``.
        frame: height and width of the frames that ``render`` makes, in pixels.
        frame_stack: kappa, frames per observation.
        frame_spacing: slots between the frames.
    """

    def __init__(self, render: Render, frame: tuple[int, int], frame_stack: int = 2, frame_spacing: int = 1):
        if frame_stack < 1 or frame_spacing < 1:
            raise ValueError(f"frame_stack {frame_stack} and frame_spacing {frame_spacing} must be at least 1")
        super().__init__(in_keys=["scene"], out_keys=["pixels"])
        self.render = render
        self.frame_stack, self.frame_spacing = frame_stack, frame_spacing
        self.frame_shape = (*frame, 3)

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        self._first_frame(require_key(incoming, "scene", "Camera", "a fleet"))
        # a bounded spec would hold its bounds for every pixel and compare them whenever an environment is built
        return {"pixels": number_spec(incoming, self.frame_stack, *self.frame_shape, dtype=torch.uint8)}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        rows = active_rows(current, "scheduled", fresh)
        history = require_key(current, "scene", "Camera", "a fleet")
        scenes = history[rows][:, self._first_frame(history) :: self.frame_spacing]
        shape = (scenes.shape[0], self.frame_stack, *self.frame_shape)
        if scenes.shape[0] == 0:
            frames = torch.empty(shape, dtype=torch.uint8, device=current.device)
        else:
            pictures = self.render(scenes.flatten(0, 1).cpu().numpy())
            frames = torch.from_numpy(pictures).view(shape).to(current.device)
        return {"pixels": scatter_rows(rows, frames)}

    def _first_frame(self, scene: TensorSpec | Tensor) -> int:
        """Index of the oldest frame in the history."""
        needed = (self.frame_stack - 1) * self.frame_spacing + 1
        if scene.shape[-2] < needed:
            raise ValueError(
                f"{self.frame_stack} frames {self.frame_spacing} slots apart need a frame_history of {needed}, "
                f"the fleet keeps {scene.shape[-2]}"
            )
        return scene.shape[-2] - needed


class Encode(SlotTransform):
    """Applies a module to the rows that need it and writes its output, zeros for the others.

    On the device's side it encodes frames before they are sent (the defaults). On the controller's side, for a payload
    that is frames, use ``Encode(encoder, d, in_key="received", mask_key="delivered")`` behind the :class:`Uplink`.

    Args:
        module: takes [N, ...] of ``in_key``, returns float [N, d]; run without gradients, where its weights lie.
        embedding_dim: d.
        in_key, out_key: what it reads and writes.
        mask_key: rows to encode; all if nobody wrote it.
    """

    def __init__(
        self,
        module: nn.Module,
        embedding_dim: int,
        in_key: str = "pixels",
        out_key: str = "embedding",
        mask_key: str = "scheduled",
    ):
        super().__init__(in_keys=[in_key], out_keys=[out_key])
        # not a submodule: an environment that moves to a device leaves the model where it is
        self._module = [module]
        self.embedding_dim, self.mask_key = embedding_dim, mask_key

    def _specs(self, incoming: Composite) -> dict[str, TensorSpec]:
        require_key(incoming, self.in_keys[0], "Encode", "the transform that makes it")
        return {self.out_keys[0]: number_spec(incoming, self.embedding_dim)}

    def _slot(self, previous: Values, current: TensorDictBase, fresh: Tensor | None) -> Values:
        rows = active_rows(current, self.mask_key, fresh)
        source = require_key(current, self.in_keys[0], "Encode", "the transform that makes it")
        if not bool(rows.any()):
            encoded = torch.zeros(0, self.embedding_dim, device=source.device)
        else:
            encoded = self._encode(source[rows])
        return {self.out_keys[0]: scatter_rows(rows, encoded)}

    @torch.no_grad()
    def _encode(self, values: Tensor) -> Tensor:
        (module,) = self._module
        weight = next(module.parameters(), None) if isinstance(module, nn.Module) else None
        there = values if weight is None else values.to(weight.device)
        return module(there).to(values.device, torch.float32)
