"""An image encoder that somebody else trained, from an ONNX file: frozen, and part of the entry that uses it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.encoder import PIXEL_MEAN, PIXEL_STD
from tsjepa.support.checks import at_least
from tsjepa.support.foreign import optional, reason


class OnnxEncoder(nn.Module):
    """Embeddings of a graph that is given by path; it has no weights to train, and runs on the CPU.

    The graph takes one input. Of five dimensions, uint8 [N, frame_stack, H, W, 3], it is an encoder of whole stacks,
    such as this package exports. Of four, [N, 3, H, W] or [N, H, W, 3], it is one of single pictures, uint8, or float
    with the mean and the standard deviation of ImageNet taken out; the features of the frames then stand side by side.
    What the graph returns is flattened and brought to unit length.

    The graph itself is stored with the weights of a model, so that an entry does not need the file.

    Args:
        path: of the .onnx file, with its weights inside; None in an entry.
        frame_stack: frames of an embedding; a graph of whole stacks states its own.
        height, width: of a frame in pixels, where the graph leaves them open.
        embedding_dim: d; found by running the graph once.

    Raises:
        FileNotFoundError: there is no such file.
        ModuleNotFoundError: onnxruntime is not installed.
        ValueError: ONNX Runtime cannot read or run it, or its input is none of those above.
    """

    def __init__(
        self,
        path: str | None,
        frame_stack: int = 2,
        height: int | None = None,
        width: int | None = None,
        embedding_dim: int | None = None,
    ) -> None:
        super().__init__()
        at_least(1, frame_stack=frame_stack)
        self.frame_stack, self.embedding_dim = frame_stack, embedding_dim
        self.height, self.width = height or 0, width or 0  # 0 is left to the graph
        # buffers, because an average of a module without any tensor is an error of torch's
        self.register_buffer("mean", torch.tensor(PIXEL_MEAN), persistent=False)
        self.register_buffer("std", torch.tensor(PIXEL_STD), persistent=False)
        self._graph = b""
        self._session: Any = None
        if path is not None:
            if not Path(path).is_file():
                raise FileNotFoundError(f"There is no ONNX file {path}.")
            self._graph = Path(path).read_bytes()
            self._open(Path(path).name)
            self.embedding_dim = self(torch.zeros(1, *self.frame_shape, dtype=torch.uint8)).shape[-1]

    @property
    def frame_shape(self) -> tuple[int, int, int, int]:
        """(frame_stack, H, W, 3)."""
        return self.frame_stack, self.height, self.width, 3

    @property
    def init_args(self) -> dict:
        """What rebuilds it, the graph apart, which comes with the weights."""
        sizes = {name: getattr(self, name) for name in ("frame_stack", "height", "width", "embedding_dim")}
        return {"path": None} | sizes

    def forward(self, frames: Tensor) -> Tensor:
        """uint8 [..., frame_stack, H, W, 3], oldest first, to embeddings [..., d] of unit length, without a gradient.

        Raises:
            ValueError: other frames than the graph's, ONNX Runtime refuses to run it, or it is being exported.
        """
        if torch.compiler.is_exporting():
            raise ValueError(
                "A model with an OnnxEncoder cannot be exported or deployed, its encoder is an ONNX graph already: run "
                "that file with ONNX Runtime, or fit a model whose encoder is a tsjepa.models.Encoder."
            )
        if frames.dtype != torch.uint8 or tuple(frames.shape[-4:]) != self.frame_shape:
            raise ValueError(
                f"The encoder takes uint8 frames of shape [..., {', '.join(map(str, self.frame_shape))}], not "
                f"{frames.dtype} {list(frames.shape)}."
            )
        if self._session is None:
            self._open("the graph of this model")
        stacks = frames.detach().cpu().reshape(-1, *self.frame_shape)
        features = torch.from_numpy(self._run(stacks if self._of_stacks else stacks.flatten(0, 1)))
        embedding = F.normalize(features.reshape(len(stacks), -1).float(), dim=-1)
        return embedding.reshape(*frames.shape[:-4], -1).to(frames.device)

    def _run(self, pictures: Tensor) -> np.ndarray:
        session = self._session
        if not self._of_bytes:
            pictures = (pictures.float() / 255 - self.mean.cpu()) / self.std.cpu()
        if self._channels_first:
            pictures = pictures.movedim(-1, 1).contiguous()
        try:
            return session.run(None, {session.get_inputs()[0].name: pictures.numpy()})[0]
        except Exception as error:  # ONNX Runtime's own kinds
            raise ValueError(f"ONNX Runtime cannot run the encoder: {reason(error)}") from error

    def _open(self, name: str) -> None:
        """Opens a session of the graph and notes what its input says."""
        runtime = optional("onnxruntime", "An ONNX encoder", "onnx")
        options = runtime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        try:
            session = runtime.InferenceSession(self._graph, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # ONNX Runtime's own kinds
            raise ValueError(f"ONNX Runtime cannot read {name}: {reason(error)}") from error
        inputs = session.get_inputs()
        shape = inputs[0].shape if len(inputs) == 1 else []
        self._of_stacks, self._channels_first = len(shape) == 5, len(shape) == 4 and shape[1] == 3
        self._of_bytes = inputs[0].type == "tensor(uint8)"
        if not (self._of_stacks or (len(shape) == 4 and 3 in (shape[1], shape[3]))):
            listed = ", ".join(f"{part.name} {part.shape}" for part in inputs)
            raise ValueError(
                f"{name} takes {listed}; an encoder takes one input [N, 3, H, W], [N, H, W, 3] or "
                "[N, frame_stack, H, W, 3]."
            )
        rows, columns = shape[2:4] if self._of_stacks or self._channels_first else shape[1:3]
        found = {"height": rows, "width": columns} | ({"frame_stack": shape[1]} if self._of_stacks else {})
        for size, value in found.items():
            if isinstance(value, int):
                setattr(self, size, value)
            elif not getattr(self, size):
                raise ValueError(f"{name} leaves its {size} open: give the encoder's {size} in pixels.")
        self._session = session

    def get_extra_state(self) -> Tensor:
        """The graph as bytes [size]: in the state, yet none of the tensors that training averages."""
        return torch.frombuffer(bytearray(self._graph), dtype=torch.uint8) if self._graph else torch.zeros(0).byte()

    def set_extra_state(self, state: Tensor) -> None:
        """Takes the graph that :meth:`get_extra_state` gave."""
        self._graph, self._session = state.cpu().numpy().tobytes(), None

    def __getstate__(self) -> dict:
        """Without the session, which can be neither copied nor sent; the next call opens another."""
        return self.__dict__ | {"_session": None}
