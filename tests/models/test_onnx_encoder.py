"""A stranger's image encoder as a file: it sees what its maker's does, trains a controller, and travels with it."""

import copy

import numpy as np
import pytest
import tiny
import tiny_controller
import tiny_data
import torch
from torch import nn

import tsjepa
from tsjepa import cli
from tsjepa.envs import Radio
from tsjepa.evaluation.rollouts import Loop, every, run
from tsjepa.models import Encoder, OnnxEncoder, SemanticController, entries
from tsjepa.models.encoder import PIXEL_MEAN, PIXEL_STD
from tsjepa.plants import CartPole
from tsjepa.zoo.deploy import Graph, deploy, save_onnx

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytestmark = pytest.mark.slow  # every test exports a graph


def export(module: nn.Module, path, *shape: int, dtype: torch.dtype = torch.uint8) -> str:
    """The module as ONNX, for any number of inputs of that shape."""
    save_onnx(Graph(module, {"frames": torch.zeros(2, *shape, dtype=dtype)}, ("embedding",)), path)
    return str(path)


class Backbone(nn.Module):
    """From pictures [N, 3, H, W] to a map of features, as published backbones have it."""

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, 4, 8, stride=8)

    def forward(self, pictures):
        return self.conv(pictures)


def test_an_exported_encoder_sees_and_scores_as_the_entry_does(tmp_path):
    model = entries.load("tsjepa-cartpole-d16")
    path = export(model.encoder, tmp_path / "encoder.onnx", *model.encoder.frame_shape)
    encoder = OnnxEncoder(path)
    assert encoder.frame_shape == model.encoder.frame_shape and encoder.embedding_dim == 16
    frames = tiny_controller.frames()
    torch.testing.assert_close(encoder(frames), model.encode(frames), atol=1e-5, rtol=0)
    torch.testing.assert_close(encoder(frames[None])[0], encoder(frames), atol=0, rtol=0)

    theirs = SemanticController(encoder, model.actor, model.frame_spacing, model.spec, model.predictor, model.probe)
    scores = []
    for controller in (model, theirs):
        loop = Loop(CartPole(), controller, num_devices=6, slots=60, radio=Radio(lossless=True))
        scores.append(run(every(loop, 5), 0).raw_score())
    torch.testing.assert_close(scores[1], scores[0], atol=1 / 60, rtol=0)  # one slot at the edge of the box
    assert scores[0].mean() > 0.1


def test_an_entry_holds_the_graph_and_does_not_need_the_file(tmp_path):
    model = tiny_controller.tiny()
    path = export(model.encoder, tmp_path / "encoder.onnx", *model.encoder.frame_shape)
    expected = model.encode(tiny_controller.frames())
    model.encoder = OnnxEncoder(path)
    entries.save(model, tmp_path / "model")
    (tmp_path / "encoder.onnx").unlink()
    again = tsjepa.load(tmp_path / "model")
    torch.testing.assert_close(again.encode(tiny_controller.frames()), expected, atol=1e-5, rtol=0)
    assert str(tmp_path) not in (tmp_path / "model" / "config.yaml").read_text()
    twin = copy.deepcopy(again)
    assert torch.equal(twin.encode(tiny_controller.frames()), again.encode(tiny_controller.frames()))
    with pytest.raises(ValueError, match="ONNX graph already"):
        deploy(str(tmp_path / "model"), str(tmp_path / "graphs"))
    assert not list(tmp_path.glob("graphs*"))


@pytest.mark.parametrize("layout", ["channels first", "channels last"])
def test_a_graph_of_single_pictures_gives_the_features_of_each_frame_side_by_side(tmp_path, layout):
    backbone = Backbone().eval()
    if layout == "channels first":
        path = export(backbone, tmp_path / "backbone.onnx", 3, 64, 64, dtype=torch.float32)
    else:

        class Last(nn.Module):
            def __init__(self) -> None:
                super().__init__()
                self.inner = backbone

            def forward(self, pictures):
                pixels = (pictures.float() / 255 - torch.tensor(PIXEL_MEAN)) / torch.tensor(PIXEL_STD)
                return self.inner(pixels.permute(0, 3, 1, 2))

        path = export(Last().eval(), tmp_path / "backbone.onnx", 64, 64, 3)
    encoder = OnnxEncoder(path, frame_stack=3)
    assert encoder.frame_shape == (3, 64, 64, 3) and encoder.embedding_dim == 3 * 4 * 8 * 8
    frames = torch.randint(0, 256, (2, 3, 64, 64, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    pixels = (frames / 255 - torch.tensor(PIXEL_MEAN)) / torch.tensor(PIXEL_STD)
    features = torch.stack([backbone(pixels[:, frame].movedim(-1, 1)).flatten(1) for frame in range(3)], dim=1)
    expected = nn.functional.normalize(features.flatten(1), dim=-1)
    torch.testing.assert_close(encoder(frames), expected.detach(), atol=1e-5, rtol=0)


def test_predictor_and_actor_are_fitted_on_it_by_a_recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    export(Encoder(2, (4, 8, 8), 16).eval(), tmp_path / "theirs.onnx", 2, 64, 128, 3)
    for name in ("recipes/jepa.yaml", "recipes/actor.yaml"):
        recipe = tiny.shrink(tiny.load(name))
        recipe["data"]["init_args"]["path"] = "data"
        if name == "recipes/jepa.yaml":
            encoder = {"class_path": "tsjepa.models.OnnxEncoder", "init_args": {"path": "theirs.onnx"}}
            recipe["model"]["init_args"]["encoder"] = encoder
        tiny.write(tmp_path, name, recipe)
    tiny_data.write(tmp_path / "data", slots=32, actor_plain=2, **tiny_data.SPLITS)
    assert cli.main(["fit", "--config", "recipes/jepa.yaml"]) == 0
    assert cli.main(["fit", "--config", "recipes/actor.yaml"]) == 0
    (tmp_path / "theirs.onnx").unlink()
    trained = tsjepa.load("runs/actor/model")
    assert isinstance(trained.encoder, OnnxEncoder)
    assert cli.main(["validate", "--config", "runs/actor/config.yaml", "--ckpt_path", "last"]) == 0


def test_what_cannot_be_is_refused_in_one_sentence(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match="There is no ONNX file"):
        OnnxEncoder(str(tmp_path / "absent.onnx"))
    (tmp_path / "text.onnx").write_text("no graph")
    with pytest.raises(ValueError, match=r"ONNX Runtime cannot read text\.onnx"):
        OnnxEncoder(str(tmp_path / "text.onnx"))
    path = export(nn.Linear(4, 2).eval(), tmp_path / "linear.onnx", 4, dtype=torch.float32)
    with pytest.raises(ValueError, match=r"linear\.onnx takes frames .*; an encoder takes one input"):
        OnnxEncoder(path)
    path = export(Backbone().eval(), tmp_path / "backbone.onnx", 3, 64, 64, dtype=torch.float32)
    graph = onnx.load(path)
    for axis in (2, 3):
        graph.graph.input[0].type.tensor_type.shape.dim[axis].dim_param = f"side{axis}"
    onnx.save(graph, path)
    with pytest.raises(ValueError, match="leaves its height open: give the encoder's height in pixels"):
        OnnxEncoder(path)
    encoder = OnnxEncoder(path, height=64, width=64)
    with pytest.raises(ValueError, match=r"takes uint8 frames of shape \[..., 2, 64, 64, 3\], not torch.uint8"):
        encoder(torch.zeros(1, 2, 32, 64, 3, dtype=torch.uint8))
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    with pytest.raises(ModuleNotFoundError, match=r"needs the package onnxruntime: install it with .*tsjepa\[onnx\]"):
        OnnxEncoder(path, height=64, width=64)
    assert np.isfinite(encoder(torch.zeros(1, 2, 64, 64, 3, dtype=torch.uint8)).numpy()).all()
