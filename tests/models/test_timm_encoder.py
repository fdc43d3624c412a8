"""A backbone of timm by class path, where timm is installed."""

import pytest
import tiny
import tiny_data
import torch

import tsjepa
from tsjepa import cli
from tsjepa.models import TimmEncoder


def test_without_timm_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "timm", None)
    with pytest.raises(ModuleNotFoundError, match=r"needs the package timm: .*'tsjepa\[timm\]'"):
        TimmEncoder()


@pytest.mark.slow
def test_a_backbone_trains_and_its_entry_loads(tmp_path, monkeypatch):
    pytest.importorskip("timm", reason="timm is an optional package and not installed")
    monkeypatch.chdir(tmp_path)
    recipe = tiny.shrink(tiny.load("recipes/jepa.yaml"))
    recipe["data"]["init_args"]["path"] = "data"
    sizes = {"backbone": "resnet10t", "embedding_dim": 16, "height": 64, "width": 128}
    recipe["model"]["init_args"]["encoder"] = {"class_path": "tsjepa.models.TimmEncoder", "init_args": sizes}
    tiny.write(tmp_path, "recipes/jepa.yaml", recipe)
    tiny_data.write(tmp_path / "data", slots=32)
    assert cli.main(["fit", "--config", "recipes/jepa.yaml"]) == 0
    model = tsjepa.load("runs/jepa/model")
    assert model.encoder.init_args["backbone"] == "resnet10t"
    frames = torch.randint(0, 256, (3, 2, 64, 128, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    embedding = model.encode(frames)
    torch.testing.assert_close(embedding.norm(dim=-1), torch.ones(3))
    changed = frames.clone()
    changed[:, 0] = 0  # the older frame counts
    assert (model.encode(changed) - embedding).abs().max() > 1e-3
    fresh = TimmEncoder(**sizes)
    first = "backbone.conv1.0.weight"
    assert not torch.equal(model.encoder.state_dict()[first], fresh.state_dict()[first])


def test_a_backbone_that_there_is_not_is_refused():
    pytest.importorskip("timm", reason="timm is an optional package and not installed")
    with pytest.raises(ValueError, match="timm makes no nothing of these settings"):
        TimmEncoder("nothing")
