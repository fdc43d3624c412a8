"""``tsjepa deploy``: a model as graphs that run without this package, on the device and at the controller."""

from __future__ import annotations

import importlib.util
import json
import logging
import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram

from tsjepa.envs.payload import embedding_codec
from tsjepa.models import AutoencoderController, Controller, entries
from tsjepa.radio.codecs import payload_bits
from tsjepa.support.files import exclusive, refuse_to_replace, replace_folder
from tsjepa.support.provenance import provenance

DESCRIPTION = "deployment.json"
CODEC = "int8"
SUFFIXES = {"onnx": "onnx", "torch_export": "pt2"}
ROWS = 2  # of the examples; a single one torch.export would take for a constant


class Device(nn.Module):
    """What runs beside the camera: frames uint8 [N, frame_stack, H, W, 3] to payload uint8 [N, bytes]."""

    def __init__(self, encoder: nn.Module, codec: nn.Module) -> None:
        super().__init__()
        self.encoder, self.codec = encoder, codec

    def forward(self, frames: Tensor) -> Tensor:
        return self.codec.encode(self.encoder(frames))


class ObservingDevice(nn.Module):
    """A device that remembers: frames, and the belief [N, d] and command [N, m] of the slot before, to payload and
    belief. A belief of zeros is none yet."""

    def __init__(self, encoder: nn.Module, codec: nn.Module, predictor: nn.Module, observer: nn.Module) -> None:
        super().__init__()
        self.encoder, self.codec, self.predictor, self.observer = encoder, codec, predictor, observer

    def forward(self, frames: Tensor, belief: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        embedding = self.encoder(frames)
        corrected = self.observer(self.predictor(belief, command), embedding, command)
        belief = torch.where((belief == 0).all(-1, keepdim=True), embedding, corrected)
        return self.codec.encode(belief), belief


class Receive(nn.Module):
    """A slot with an update: payload uint8 [N, bytes] and set-points [N, r] to embedding [N, d] and command [N, m]."""

    def __init__(self, codec: nn.Module, act: nn.Module) -> None:
        super().__init__()
        self.codec, self.act = codec, act

    def forward(self, payload: Tensor, reference: Tensor | None = None) -> tuple[Tensor, Tensor]:
        embedding = self.codec.decode(payload)
        return embedding, self.act(embedding, reference)


class Predict(nn.Module):
    """A slot without one: embedding [N, d] and command [N, m] of the slot before (and set-points) to those of this."""

    def __init__(self, predictor: nn.Module, act: nn.Module) -> None:
        super().__init__()
        self.predictor, self.act = predictor, act

    def forward(self, embedding: Tensor, command: Tensor, reference: Tensor | None = None) -> tuple[Tensor, Tensor]:
        embedding = self.predictor(embedding, command)
        return embedding, self.act(embedding, reference)


class Reconstruct(nn.Module):
    """How an autoencoder acts: embedding [N, d] to frames, to the state, by the law (and set-points) to a command."""

    def __init__(self, decoder: nn.Module, estimator: nn.Module, law: nn.Module) -> None:
        super().__init__()
        self.decoder, self.estimator, self.law = decoder, estimator, law

    def forward(self, embedding: Tensor, reference: Tensor | None = None) -> Tensor:
        return self.law(self.estimator(self.decoder.draw(embedding)), reference)


class Graph(NamedTuple):
    """A module to export, examples of its inputs, and the names of its outputs."""

    module: nn.Module
    inputs: dict[str, Tensor]
    outputs: tuple[str, ...]


def graphs(model: Controller) -> dict[str, Graph]:
    """What a deployment consists of: ``device``, ``receive`` and, where the model has a predictor, ``predict``.

    Each holds only the parts that it needs; the device of a model with an observer has the predictor too. Where the
    actor takes set-points they are an input of the last two.

    Raises:
        ValueError: the model has no actor, or came without the ranges of its integer codec.
    """
    model.check_acts()
    codec = embedding_codec(CODEC, model)
    if isinstance(model, AutoencoderController):
        act, set_points = Reconstruct(model.decoder, model.estimator, model.law), model.spec.reference_dim
    else:
        act, set_points = model.actor, len(getattr(model.actor, "reference_low", ()))
    frames = torch.zeros((ROWS, *model.encoder.frame_shape), dtype=torch.uint8)
    embedding, command = torch.zeros(ROWS, model.embedding_dim), torch.zeros(ROWS, model.spec.action_dim)
    reference = {"reference": torch.zeros(ROWS, set_points)} if set_points else {}
    payload = {"payload": codec.encode(embedding)}
    device = Graph(Device(model.encoder, codec), {"frames": frames}, ("payload",))
    if model.has_observer:
        watches = ObservingDevice(model.encoder, codec, model.predictor, model.observer)
        inputs = {"frames": frames, "belief": embedding, "command": command}
        device = Graph(watches, inputs, ("payload", "next_belief"))
    made = {
        "device": device,
        "receive": Graph(Receive(codec, act), payload | reference, ("embedding", "command")),
    }
    if model.has_predictor:
        inputs, outputs = {"embedding": embedding, "command": command}, ("next_embedding", "next_command")
        made["predict"] = Graph(Predict(model.predictor, act), inputs | reference, outputs)
    return made


def traced(graph: Graph) -> ExportedProgram:
    """The graph for any number of rows."""
    rows = Dim("rows")
    program = torch.export.export(
        graph.module.eval(), tuple(graph.inputs.values()), dynamic_shapes=tuple({0: rows} for _ in graph.inputs)
    )
    for node in program.graph.nodes:
        node.meta.pop("stack_trace", None)  # it names files of this machine
    return program


def save_onnx(graph: Graph, path: Path) -> None:
    """Writes the graph for ONNX Runtime and its like."""
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # warns that there is no torchvision
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # between torch and its own pytree
        program = torch.onnx.export(
            traced(graph), input_names=list(graph.inputs), output_names=list(graph.outputs), verbose=False
        )
    program.save(path)


def save_program(graph: Graph, path: Path) -> None:
    """Writes the graph for ``torch.export.load``."""
    torch.export.save(traced(graph), path)


def deploy(model: str, folder: str, format: Literal["onnx", "torch_export"] = "onnx") -> dict:
    """Writes ``model`` to ``folder`` as graphs, with int8 embeddings between device and controller.

    ``device`` turns frames into a payload, ``receive`` a payload into an embedding and a command, and ``predict`` the
    embedding and the command of one slot into those of the next. With an observer, ``device`` also takes the belief
    and the command of the slot before and gives the next belief. Each takes any number of rows; ``deployment.json``
    says what else a user has to know.

    Args:
        model: name or folder of a zoo entry.
        folder: made, or replaced where it holds an earlier deployment.
        format: onnx, or programs of torch.export.

    Returns:
        ``folder`` and the names of its ``files``.

    Raises:
        FileExistsError: ``folder`` holds something else.
        ModuleNotFoundError: a package that writes ONNX is not installed.
        ValueError: the model came without the ranges of its integer codec, or its encoder cannot be exported.
    """
    target = Path(folder).absolute()
    refuse_to_replace(target, "deployment", DESCRIPTION)
    lacking = [name for name in ("onnx", "onnxscript") if format == "onnx" and importlib.util.find_spec(name) is None]
    if lacking:
        raise ModuleNotFoundError(f"The format onnx needs the package {lacking[0]}: pip install 'tsjepa[onnx]'.")
    # torch.export.save knows no other format
    controller = entries.load(model).to(memory_format=torch.contiguous_format)
    parts = graphs(controller)
    partial = target.with_name(target.name + ".partial")
    with exclusive(target):
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        try:
            for name, graph in parts.items():
                save = save_onnx if format == "onnx" else save_program
                save(graph, partial / f"{name}.{SUFFIXES[format]}")
            (partial / DESCRIPTION).write_text(json.dumps(description(model, controller, parts), indent=2) + "\n")
            replace_folder(partial, target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    files = sorted(path.name for path in target.iterdir())
    print(f"{model} deployed to {folder}: {', '.join(files)}.")
    return {"folder": folder, "files": files}


def description(name: str, model: Controller, parts: dict[str, Graph]) -> dict:
    """What a user of the graphs has to know: shapes, payload, which frames make a stack, and the machine."""
    spec, takes = model.spec, parts["receive"].inputs
    return {
        "made_by": provenance(),
        "model": name,
        "codec": CODEC,
        "payload_bits": int(payload_bits(parts["receive"].inputs["payload"])[0]),
        "frame": list(spec.frame),
        "frame_stack": model.frame_stack,
        "frame_spacing_slots": model.frame_spacing,
        "slot_seconds": spec.slot,
        "command": _numbers(spec.action_names, spec.action_units),
        "command_low": list(spec.action_low),
        "command_high": list(spec.action_high),
        "plant": (model.metrics or {}).get("plant") or model.plant,
        "reference": _numbers(spec.reference_names, spec.reference_units) if "reference" in takes else [],
        "graphs": {
            part: {
                "inputs": {name: _signature(tensor) for name, tensor in graph.inputs.items()},
                "outputs": {
                    name: _signature(tensor) for name, tensor in zip(graph.outputs, _outputs(graph), strict=True)
                },
            }
            for part, graph in parts.items()
        },
    }


def _outputs(graph: Graph) -> tuple[Tensor, ...]:
    with torch.no_grad():
        made = graph.module(*graph.inputs.values())
    return made if isinstance(made, tuple) else (made,)


def _numbers(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """What each number is and its unit."""
    return [f"{name} ({unit})" for name, unit in zip(names, units, strict=False)]


def _signature(tensor: Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} [rows, {', '.join(map(str, tensor.shape[1:]))}]"
