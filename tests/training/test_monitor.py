from types import SimpleNamespace

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from tsjepa.support.spec import PlantSpec
from tsjepa.training import monitor
from tsjepa.training.monitor import (
    CollapseError,
    RepresentationMonitor,
    action_sensitivity,
    effective_rank,
    linear_probe_rmse,
    prediction_skill,
)

SPEC = PlantSpec(action_low=(-0.3,), action_high=(0.3,), slot=0.02, frame=(64, 128))


def circle(episodes: int, slots: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Embeddings that turn in the plane by the command in radians; [episodes, slots, 2] and [episodes, slots, 1]."""
    turn = 0.2 + 0.1 * torch.rand(episodes, slots, 1, generator=torch.Generator().manual_seed(0))
    angle = torch.cat((torch.zeros(episodes, 1, 1), turn.cumsum(1)[:, :-1]), dim=1)
    return torch.cat((angle.cos(), angle.sin()), dim=-1), turn


class Turn(nn.Module):
    def forward(self, embedding, command):
        x, y = embedding.unbind(-1)
        cos, sin = command[..., 0].cos(), command[..., 0].sin()
        return torch.stack((cos * x - sin * y, sin * x + cos * y), dim=-1)


class Copy(nn.Module):
    def forward(self, embedding, command):
        return embedding


def test_effective_rank_of_isotropic_and_of_rank_one_data():
    d = 6
    assert effective_rank(torch.cat((torch.eye(d), -torch.eye(d)))).item() == pytest.approx(d, rel=1e-4)
    line = torch.linspace(-1, 1, 20)[:, None] * torch.ones(1, d)
    assert effective_rank(line + 3).item() == pytest.approx(1, abs=1e-3)


def test_action_sensitivity_is_one_for_a_copy_and_the_cosine_of_twice_the_turn():
    embedding, _ = circle(2, 10)
    assert action_sensitivity(Copy(), embedding, SPEC).item() == pytest.approx(1)
    assert action_sensitivity(Turn(), embedding, SPEC).item() == pytest.approx(torch.tensor(0.6).cos().item())


def test_skill_is_one_for_a_perfect_predictor_and_zero_for_a_copying_one():
    embedding, action = circle(3, 40)
    horizons = (1, 5, 25, 50)
    perfect = prediction_skill(Turn(), embedding, action, horizons)
    copied = prediction_skill(Copy(), embedding, action, horizons)
    assert set(perfect) == set(copied) == {1, 5, 25}  # 50 slots do not fit
    assert all(value.item() == pytest.approx(1, abs=1e-4) for value in perfect.values())
    assert all(value.item() == pytest.approx(0, abs=1e-6) for value in copied.values())


def test_the_linear_probe_reads_a_state_that_is_linear_in_the_embedding():
    embedding = F.normalize(torch.randn(6, 30, 8, generator=torch.Generator().manual_seed(0)), dim=-1)
    state = embedding @ torch.randn(8, 4, generator=torch.Generator().manual_seed(1)) + 2
    assert (linear_probe_rmse(embedding, state, ridge=1e-9) < 1e-3).all()
    noise = torch.randn(6, 30, 4, generator=torch.Generator().manual_seed(2))
    assert (linear_probe_rmse(embedding, noise) > 0.8).all()


def test_a_single_trajectory_is_probed_by_its_halves():
    embedding = F.normalize(torch.randn(1, 60, 8, generator=torch.Generator().manual_seed(0)), dim=-1)
    state = embedding @ torch.randn(8, 4, generator=torch.Generator().manual_seed(1)) + 2
    assert (linear_probe_rmse(embedding, state, ridge=1e-9) < 1e-3).all()
    state[:, 30:] += 1
    torch.testing.assert_close(
        linear_probe_rmse(embedding, state, ridge=1e-9), torch.ones(4).double(), rtol=1e-2, atol=0
    )


@pytest.mark.parametrize(
    ("metrics", "sentence"),
    [
        ({"effective_rank": 1.2, "action_sensitivity": 0.5}, r"effective rank 1\.20 is below 2"),
        ({"effective_rank": 9.0, "action_sensitivity": 0.99999}, r"copying: .* extreme commands is 0\.99999"),
    ],
)
def test_a_collapse_stops_the_fit_with_the_measure_that_collapsed(monkeypatch, metrics, sentence):
    monkeypatch.setattr(monitor, "representation_metrics", lambda *args: {**metrics, "skill_1": 0.0, "skill_5": 1.0})
    logged = {}
    module = SimpleNamespace(
        encoder=None,
        predictor=None,
        log=lambda *args, **kwargs: None,
        log_dict=lambda values, **kwargs: logged.update(values),
    )
    trainer = SimpleNamespace(
        datamodule=SimpleNamespace(frame_spacing=1, spec=SPEC),
        state=SimpleNamespace(fn="fit"),
        sanity_checking=False,
        current_epoch=5,
    )
    callback = RepresentationMonitor(patience_epochs=5)
    with pytest.raises(CollapseError, match=sentence):
        callback.on_validation_batch_end(trainer, module, None, None, 0)
    assert logged["val/skill"] == 0.5
    trainer.current_epoch = 4
    callback.on_validation_batch_end(trainer, module, None, None, 0)


def test_a_healthy_representation_passes():
    RepresentationMonitor().check({"effective_rank": 9.0, "action_sensitivity": 0.5})
