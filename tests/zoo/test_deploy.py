"""The exported graphs against the PyTorch model, as other programs would run them."""

import json
import os

import numpy as np
import onnxruntime
import pytest
import tiny_controller
import torch
from torch import nn
from tsjepa.envs.embedding_codec import embedding_codec
from tsjepa.evaluation.closed_loop import SemanticPolicy, Starts, run

from tsjepa import cli
from tsjepa.envs import Renderer
from tsjepa.models import entries
from tsjepa.zoo.deploy import deploy, graphs

ROWS = (1, 3, 5)
SHIPPED = "tsjepa-cartpole"


def pictures(model: nn.Module, count: int, seed: int = 0) -> torch.Tensor:
    """What the camera sees of ``count`` cart-poles that move: uint8 [count, frame_stack, 64, 128, 3]."""
    draw = np.random.default_rng(seed)
    stack = model.encoder.frame_shape[0]
    start = draw.uniform((-0.8, -0.3), (0.8, 0.3), (count, 1, 2))
    qpos = start + draw.normal(0, 0.02, (count, 1, 2)) * np.arange(stack)[:, None]
    return torch.from_numpy(Renderer().render(qpos.reshape(-1, 2), None)).unflatten(0, (count, stack))


def with_ranges(model: nn.Module) -> nn.Module:
    """The model with the ranges of its embeddings of some pictures, where it came without."""
    if model.code_low.isnan().any():
        embedding = model.encode(pictures(model, 200, seed=1))
        model.code_low.copy_(embedding.amin(0))
        model.code_high.copy_(embedding.amax(0))
    return model


def untrained(model: nn.Module) -> nn.Module:
    """The model with ranges of its own; the tiny models come with random ones."""
    model.code_low.fill_(torch.nan)
    return with_ranges(model.eval())


MODELS = {
    "tiny": lambda: untrained(tiny_controller.tiny()),
    "tiny autoencoder": lambda: untrained(tiny_controller.tiny_autoencoder()),
    "shipped": lambda: with_ranges(entries.load(SHIPPED)),
}
CASES = [("tiny", "onnx"), ("tiny", "torch_export"), ("tiny autoencoder", "onnx"), ("shipped", "onnx")]


class OnnxGraph:
    def __init__(self, path) -> None:
        self.session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])

    def __call__(self, *inputs: torch.Tensor) -> list[torch.Tensor]:
        named = {place.name: value.numpy() for place, value in zip(self.session.get_inputs(), inputs, strict=True)}
        return [torch.from_numpy(output) for output in self.session.run(None, named)]


class ExportedGraph:
    def __init__(self, path) -> None:
        self.module = torch.export.load(path).module()

    def __call__(self, *inputs: torch.Tensor) -> list[torch.Tensor]:
        with torch.no_grad():
            outputs = self.module(*inputs)
        return list(outputs) if isinstance(outputs, tuple) else [outputs]


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def deployment(request, tmp_path_factory):
    """A model, its deployment's folder, and the graphs in it by name."""
    name, form = request.param
    folder = tmp_path_factory.mktemp("deployment")
    model = entries.load(entries.save(MODELS[name](), folder / "model"))
    deploy(str(folder / "model"), str(folder / "graphs"), form)
    load = {"onnx": OnnxGraph, "torch_export": ExportedGraph}[form]
    paths = [path for path in (folder / "graphs").iterdir() if path.suffix != ".json"]
    return model, folder / "graphs", {path.stem: load(path) for path in paths}


def test_a_device_sends_what_the_model_would(deployment):
    model, _, run_graph = deployment
    codec = embedding_codec("int8", model)
    for rows in ROWS:
        frames = pictures(model, rows, seed=rows)
        (payload,) = run_graph["device"](frames)
        assert payload.dtype == torch.uint8
        embedding = model.encode(frames)
        off = (payload.int() - codec.encode(embedding).int()).abs()
        assert off.max() <= 1
        # only a value half-way between two levels may go to the other one, where the sum was rounded otherwise
        step = (model.code_high - model.code_low) / 255
        from_halfway = ((embedding - model.code_low) / step % 1 - 0.5).abs() * step
        assert (from_halfway[off > 0] < 1e-6).all()


def test_a_controller_makes_of_a_payload_what_the_model_would(deployment):
    model, _, run_graph = deployment
    codec = embedding_codec("int8", model)
    for rows in ROWS:
        payload = codec.encode(model.encode(pictures(model, rows, seed=rows)))
        embedding, command = run_graph["receive"](payload)
        expected = codec.decode(payload)
        torch.testing.assert_close(embedding, expected, atol=1e-4, rtol=0)
        torch.testing.assert_close(command, model.act(expected), atol=1e-4, rtol=1e-5)


def test_a_controller_predicts_what_the_model_would(deployment):
    model, _, run_graph = deployment
    if not model.has_predictor:
        assert set(run_graph) == {"device", "receive"}
        return
    for rows in ROWS:
        embedding = model.encode(pictures(model, rows, seed=rows))
        command = torch.linspace(-20, 20, rows)[:, None]
        predicted, following = run_graph["predict"](embedding, command)
        expected = model.predict(embedding, command)
        torch.testing.assert_close(predicted, expected, atol=1e-4, rtol=0)
        torch.testing.assert_close(following, model.act(expected), atol=1e-4, rtol=1e-5)


def test_the_graphs_close_the_loop_as_the_model_does(deployment):
    model, _, run_graph = deployment
    renderer, codec = Renderer(), embedding_codec("int8", model)
    policy = SemanticPolicy(model, renderer.render, 3, codec=lambda sent: codec.decode(codec.encode(sent)))
    starts = Starts(0, 2, 8, model.frame_history, model.spec.slot)
    belief = command = None

    def by_graphs(slot: int, observation) -> torch.Tensor:
        nonlocal belief, command
        if slot % 3 == 0:
            belief, command = run_graph["receive"](*run_graph["device"](policy.frames(observation)))
        elif "predict" in run_graph:
            belief, command = run_graph["predict"](belief, command)
        return command

    expected, found = run(starts, policy), run(starts, by_graphs)
    # a level that was rounded otherwise moves the command of the trained model by about 0.01 N
    torch.testing.assert_close(found.action, expected.action, atol=0.1, rtol=0)
    torch.testing.assert_close(found.state, expected.state, atol=1e-3, rtol=0)


def test_the_files_hold_the_weights_they_need_and_nothing_of_this_machine(deployment):
    model, folder, _ = deployment
    parts = {"device": ["encoder"], "receive": ["actor"], "predict": ["predictor", "actor"]}
    for path in folder.iterdir():
        content = path.read_bytes()
        assert os.fsencode(os.path.dirname(torch.__file__)) not in content
        assert os.fsencode(os.path.dirname(entries.__file__)) not in content
        if path.suffix != ".json" and hasattr(model, "actor"):
            values = sum(p.numel() for part in parts[path.stem] for p in getattr(model, part).parameters())
            assert 4 * values <= len(content) <= 4 * values + 400_000


def test_the_description_says_what_goes_in_and_comes_out(deployment):
    model, folder, _ = deployment
    said = json.loads((folder / "deployment.json").read_text())
    d, stack = model.embedding_dim, model.frame_stack
    assert said["payload_bits"] == 8 * d
    assert (said["frame_stack"], said["frame_spacing_slots"]) == (stack, model.frame_spacing)
    assert said["slot_seconds"] == model.spec.slot
    assert said["graphs"]["device"] == {
        "inputs": {"frames": f"uint8 [rows, {stack}, 64, 128, 3]"},
        "outputs": {"payload": f"uint8 [rows, {d}]"},
    }
    assert said["graphs"]["receive"]["outputs"] == {"embedding": f"float32 [rows, {d}]", "command": "float32 [rows, 1]"}


@pytest.fixture
def entry(tmp_path):
    return str(entries.save(MODELS["tiny"](), tmp_path / "model"))


def test_a_controller_without_a_predictor_has_two_graphs():
    assert list(graphs(untrained(tiny_controller.tiny_supervised()))) == ["device", "receive"]
    assert list(graphs(MODELS["tiny"]())) == ["device", "receive", "predict"]


def test_a_folder_with_something_else_in_it_is_left_alone(entry, tmp_path):
    with pytest.raises(FileExistsError, match="is no deployment"):
        deploy(entry, str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_an_interrupted_deployment_leaves_the_one_before(entry, tmp_path, monkeypatch):
    deploy(entry, str(tmp_path / "graphs"), "torch_export")
    before = {path.name: path.read_bytes() for path in (tmp_path / "graphs").iterdir()}
    with monkeypatch.context() as patch, pytest.raises(OSError, match="no space"):
        patch.setattr(torch.export, "save", lambda program, path: (_ for _ in ()).throw(OSError("no space")))
        deploy(entry, str(tmp_path / "graphs"), "torch_export")
    assert {path.name: path.read_bytes() for path in (tmp_path / "graphs").iterdir()} == before
    deploy(entry, str(tmp_path / "graphs"), "torch_export")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["graphs", "model"]
    assert {path.name for path in (tmp_path / "graphs").iterdir()} == set(before)


def test_a_model_without_ranges_writes_nothing(tmp_path):
    model = tiny_controller.tiny()
    model.code_low.fill_(torch.nan)
    entries.save(model, tmp_path / "model")
    with pytest.raises(ValueError, match="needs ranges"):
        deploy(str(tmp_path / "model"), str(tmp_path / "graphs"))
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


@pytest.mark.parametrize("package", ["onnx", "onnxscript"])
def test_without_a_package_that_writes_onnx_it_says_which(entry, tmp_path, monkeypatch, package):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == package else object())
    with pytest.raises(ModuleNotFoundError, match=rf"needs the package {package}: pip install 'tsjepa\[onnx\]'"):
        deploy(entry, str(tmp_path / "graphs"))
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


@pytest.mark.parametrize(
    ("model", "folder", "form"),
    [("nobody", "graphs", "onnx"), ("recipes", "graphs", "onnx"), (SHIPPED, ".", "onnx"), (SHIPPED, "graphs", "zip")],
)
def test_the_command_refuses_in_one_sentence(tmp_path, monkeypatch, capsys, model, folder, form):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    try:
        status = cli.main(["deploy", "--model", model, "--folder", folder, "--format", form])
    except SystemExit as exit_:
        status = exit_.code
    said = capsys.readouterr().err
    assert status == 2
    assert said.count("\n") == 1
    assert "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
