"""A deployment that `tsjepa deploy` has written, run by ONNX Runtime on one core."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tsjepa.support.files import read_json
from tsjepa.support.spec import PlantSpec

DESCRIPTION = "deployment.json"
WANTED = ("frame", "command_low", "command_high", "plant")  # that earlier versions did not write


class Graphs:
    """The graphs of a folder and what ``deployment.json`` says about them.

    Args:
        folder: as ``tsjepa deploy MODEL FOLDER`` has written it, in the format onnx.
        parts: those that are needed; of a missing "predict" the model has none, and ``predict`` is None.
        reference: set-points [r] that the controller gives the actor, in their units; None at a device.

    Raises:
        FileNotFoundError: it is no such folder.
        ValueError: an older deployment, a damaged description, or set-points that the model does not take.
        ModuleNotFoundError: the package onnxruntime is not installed.
    """

    def __init__(self, folder: str, parts: Sequence[str], reference: Sequence[float] | None = None) -> None:
        path = Path(folder)
        if not (path / DESCRIPTION).is_file():
            raise FileNotFoundError(f"{folder} is no deployment: make one with `tsjepa deploy MODEL {folder}`.")
        self.description: dict[str, Any] = read_json(path / DESCRIPTION)
        graphs = self.description.get("graphs", {})
        if lacking := [name for name in WANTED if name not in self.description]:
            raise ValueError(f"{folder} was deployed by an older version ({lacking[0]} is missing): deploy it anew.")
        takes = self.description["reference"]
        if reference is not None and len(takes) != len(reference):
            raise ValueError(f"The model takes {len(takes)} set-points {takes}, and was given {list(reference)}.")
        self.reference = np.asarray([reference], np.float32) if reference else None
        self.low, self.high = (np.asarray(self.description[f"command_{end}"], np.float32) for end in ("low", "high"))
        self.slot: float = self.description["slot_seconds"]
        self.frame_stack: int = self.description["frame_stack"]
        self.frame_spacing: int = self.description["frame_spacing_slots"]
        self.frame: tuple[int, int] = tuple(self.description["frame"])
        self.payload_bytes: int = self.description["payload_bits"] // 8
        self._run = {part: _session(path / f"{part}.onnx", part) for part in parts if part in graphs}

    @property
    def rest(self) -> np.ndarray:
        """The command [m] that is nearest to zero."""
        return np.float32(self.spec.rest)

    @property
    def spec(self) -> PlantSpec:
        """What a deployment says of its machine: commands, slot and pictures."""
        return PlantSpec(tuple(self.low.tolist()), tuple(self.high.tolist()), self.slot, self.frame)

    @property
    def has_predictor(self) -> bool:
        """Whether there is a graph that predicts."""
        return "predict" in self._run

    @property
    def belief_dim(self) -> int:
        """d of what the device remembers; 0 of one that sends what it sees."""
        inputs = {given.name: given for given in self._run["device"].get_inputs()}
        return inputs["belief"].shape[1] if "belief" in inputs else 0

    def observe(self, frames: np.ndarray, belief: np.ndarray, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Payloads uint8 [n, bytes] and beliefs [n, d] of this slot's stacks and of the slot before; zeros are none."""
        return tuple(self._run["device"].run(None, {"frames": frames, "belief": belief, "command": command}))

    def encode(self, frames: np.ndarray) -> np.ndarray:
        """Payloads uint8 [n, bytes] of stacks uint8 [n, frame_stack, H, W, 3]."""
        return self._run["device"].run(None, {"frames": frames})[0]

    def receive(self, payload: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Embeddings [n, d] and commands [n, m] of payloads uint8 [n, bytes]."""
        return self._with_reference("receive", payload=payload)

    def predict(self, embedding: np.ndarray, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Embeddings [n, d] and commands [n, m] one slot after those given."""
        return self._with_reference("predict", embedding=embedding, command=command)

    def _with_reference(self, part: str, **inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.reference is not None:
            inputs["reference"] = np.repeat(self.reference, len(next(iter(inputs.values()))), axis=0)
        return tuple(self._run[part].run(None, inputs))


def _session(path: Path, part: str) -> Any:
    if not path.is_file():
        raise FileNotFoundError(f"{path.parent} holds no {part}.onnx: deploy the model with --format onnx.")
    try:
        import onnxruntime
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("ONNX graphs need onnxruntime: pip install 'tsjepa[device]'.") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = False  # it keeps a buffer of every number of rows it has met
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
