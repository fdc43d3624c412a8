"""The exported graphs against the PyTorch model, as other programs would run them."""

import json
import os

import numpy as np
import onnxruntime
import pytest
import tiny_controller
import torch
from torch import nn

from tsjepa import cli
from tsjepa.envs import Radio
from tsjepa.envs.make import make_policy
from tsjepa.envs.payload import embedding_codec
from tsjepa.evaluation.rollouts import Loop, every, run
from tsjepa.models import AutoencoderController, Observer, entries
from tsjepa.plants import CartPole
from tsjepa.zoo.deploy import deploy, graphs

ROWS = (1, 3, 5)
SHIPPED = "tsjepa-cartpole"


def pictures(model: nn.Module, count: int, seed: int = 0) -> torch.Tensor:
    """What the camera sees of ``count`` cart-poles that move: uint8 [count, frame_stack, 64, 128, 3]."""
    draw = np.random.default_rng(seed)
    stack, plant = model.frame_stack, CartPole()
    start = draw.uniform((-0.8, -0.3), (0.8, 0.3), (count, 1, 2))
    qpos = (start + draw.normal(0, 0.02, (count, 1, 2)) * np.arange(stack)[:, None]).reshape(-1, 2)
    device = np.arange(len(qpos))
    scene = plant.scene(np.concatenate([qpos, 0 * qpos], axis=1), 0, device, device)
    return torch.from_numpy(plant.render(scene)).unflatten(0, (count, stack))


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


def observed(model: nn.Module) -> nn.Module:
    """The model with an observer that is not trained."""
    model.observer = Observer(model.embedding_dim, gain=0.6)
    return model


MODELS = {
    "tiny": lambda: untrained(tiny_controller.tiny()),
    "tiny with set-points": lambda: untrained(tiny_controller.tiny(set_points=1)),
    "tiny with an observer": lambda: untrained(observed(tiny_controller.tiny())),
    "tiny autoencoder": lambda: untrained(tiny_controller.tiny_autoencoder()),
    "shipped": lambda: with_ranges(entries.load(SHIPPED)),
    "differences of convolved frames": lambda: with_ranges(entries.load("tsjepa-cartpole-appearance")),
}
CASES = [
    pytest.param(("tiny", "torch_export"), id="tiny-torch_export"),
    # a device with an observer takes and gives more: it has a test of its own
    *(
        pytest.param((name, "onnx"), id=f"{name}-onnx", marks=pytest.mark.slow)
        for name in MODELS
        if name != "tiny with an observer"
    ),
]


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


@pytest.fixture(scope="module", params=CASES)
def deployment(request, tmp_path_factory):
    """A model, its deployment's folder, and the graphs in it by name."""
    name, form = request.param
    folder = tmp_path_factory.mktemp("deployment")
    model = entries.load(entries.save(MODELS[name](), folder / "model"))
    deploy(str(folder / "model"), str(folder / "graphs"), form)
    load = {"onnx": OnnxGraph, "torch_export": ExportedGraph}[form]
    paths = [path for path in (folder / "graphs").iterdir() if path.suffix != ".json"]
    return model, folder / "graphs", {path.stem: load(path) for path in paths}


def set_points(model: nn.Module, rows: int) -> list[torch.Tensor]:
    """What the graphs take beside their other inputs: set-points [rows, 1], or nothing."""
    takes = isinstance(model, AutoencoderController) or model.actor.reference_low
    return [torch.linspace(-0.5, 0.8, rows)[:, None]] if takes else []


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
        reference = set_points(model, rows)
        embedding, command = run_graph["receive"](payload, *reference)
        expected = codec.decode(payload)
        torch.testing.assert_close(embedding, expected, atol=1e-4, rtol=0)
        torch.testing.assert_close(command, model.act(expected, *reference), atol=1e-4, rtol=1e-5)


def test_a_controller_predicts_what_the_model_would(deployment):
    model, _, run_graph = deployment
    if not model.has_predictor:
        assert set(run_graph) == {"device", "receive"}
        return
    for rows in ROWS:
        embedding = model.encode(pictures(model, rows, seed=rows))
        command = torch.linspace(-20, 20, rows)[:, None]
        reference = set_points(model, rows)
        predicted, following = run_graph["predict"](embedding, command, *reference)
        expected = model.predict(embedding, command)
        torch.testing.assert_close(predicted, expected, atol=1e-4, rtol=0)
        torch.testing.assert_close(following, model.act(expected, *reference), atol=1e-4, rtol=1e-5)


def test_the_graphs_close_the_loop_as_the_model_does(deployment):
    model, _, run_graph = deployment
    plant, period = CartPole(set_point_step=0.3, set_point_slots=4), 3
    device = Loop(plant, model, num_devices=2, slots=8, radio=Radio(codec="int8", lossless=True))
    expected = run(every(device, period), 0)
    env, policy = every(device, period).env(0), make_policy(plant, model, device.radio)
    now = env.reset()
    for slot in range(device.slots):
        reference = [now["reference"]] if set_points(model, 2) else []
        if slot % period == 0:
            (payload,) = run_graph["device"](now["pixels"])
            belief, command = run_graph["receive"](payload, *reference)
        elif "predict" in run_graph:
            belief, command = run_graph["predict"](belief, command, *reference)
        # a level that was rounded otherwise moves the command of the trained model by about 0.01 N
        torch.testing.assert_close(command, expected.action[slot], atol=0.1, rtol=0)
        now = env.step_and_maybe_reset(policy(now))[1]


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


@pytest.mark.parametrize("name", ["tiny", "tiny with set-points", "tiny with an observer", "tiny autoencoder"])
def test_a_graph_holds_the_parts_that_it_uses_and_no_others(name):
    model = MODELS[name]()
    kept = {"receive": set(), "predict": set()}
    own = {parameter.data_ptr(): part.split(".")[0] for part, parameter in model.named_parameters()}
    for part, graph in graphs(model).items():
        kept[part] = {own[parameter.data_ptr()] for parameter in graph.module.parameters()}
    assert kept["device"] == {"encoder"} | ({"predictor", "observer"} if "observer" in name else set())
    act = {"decoder", "estimator"} if name == "tiny autoencoder" else {"actor"}
    assert kept["receive"] == act
    assert kept["predict"] == (act | {"predictor"} if model.has_predictor else set())


def test_the_description_says_what_goes_in_and_comes_out(deployment):
    model, folder, _ = deployment
    said = json.loads((folder / "deployment.json").read_text())
    d, stack = model.embedding_dim, model.frame_stack
    assert said["payload_bits"] == 8 * d
    assert said["frame"] == [64, 128]
    assert (said["frame_stack"], said["frame_spacing_slots"]) == (stack, model.frame_spacing)
    assert said["slot_seconds"] == model.spec.slot
    assert said["graphs"]["device"] == {
        "inputs": {"frames": f"uint8 [rows, {stack}, 64, 128, 3]"},
        "outputs": {"payload": f"uint8 [rows, {d}]"},
    }
    assert said["graphs"]["receive"]["outputs"] == {"embedding": f"float32 [rows, {d}]", "command": "float32 [rows, 1]"}
    assert said["command"] == ["force (N)"]
    assert (said["command_low"], said["command_high"]) == ([-20.0], [20.0])
    assert said["plant"] == ((model.metrics or {}).get("plant") or model.plant)
    takes = bool(set_points(model, 1))
    assert said["reference"] == (["x (m)"] if takes else [])
    assert said["graphs"]["receive"]["inputs"].get("reference") == ("float32 [rows, 1]" if takes else None)


@pytest.mark.parametrize("options", [{"hidden_dim": 12}, {"hidden_dim": 12, "memory": False}])
def test_a_device_that_remembers_sends_its_belief(tmp_path, options):
    model = MODELS["tiny with an observer"]()
    torch.manual_seed(0)
    model.observer = Observer(model.embedding_dim, **options).eval()
    with torch.no_grad():
        for weights in model.observer.parameters():
            weights.add_(0.1 * torch.randn_like(weights))
    deploy(str(entries.save(model, tmp_path / "model")), str(tmp_path / "graphs"), "torch_export")
    said = json.loads((tmp_path / "graphs" / "deployment.json").read_text())["graphs"]["device"]
    d = model.embedding_dim
    assert said["inputs"] == {
        "frames": "uint8 [rows, 2, 64, 128, 3]", "belief": f"float32 [rows, {d}]", "command": "float32 [rows, 1]"
    }  # fmt: skip
    assert said["outputs"] == {"payload": f"uint8 [rows, {d}]", "next_belief": f"float32 [rows, {d}]"}
    run_device = ExportedGraph(tmp_path / "graphs" / "device.pt2")
    frames, command = pictures(model, 4, seed=4), torch.linspace(-20, 20, 4)[:, None]
    belief = model.encode(pictures(model, 4, seed=5))
    belief[1] = 0  # of a device that begins
    payload, after = run_device(frames, belief, command)
    expected = model.correct(belief, command, model.encode(frames))
    expected[1] = model.encode(frames)[1]
    torch.testing.assert_close(after, expected, atol=1e-5, rtol=0)
    off = (payload.int() - embedding_codec("int8", model).encode(expected).int()).abs()
    assert off.max() <= 1 and not torch.equal(expected, model.encode(frames))


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


@pytest.mark.slow
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
