"""Skill over copying with its interval, and the command error, against known answers."""

from types import SimpleNamespace

import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from torch import nn

from tsjepa.evaluation.open_loop import command_error, skill_over_copying
from tsjepa.support.spec import PlantSpec


class Turn(nn.Module):
    """Turns by a share of the command in radians."""

    def __init__(self, share: float) -> None:
        super().__init__()
        self.share = share

    def forward(self, embedding, command):
        x, y = embedding.unbind(-1)
        cos, sin = (self.share * command[..., 0]).cos(), (self.share * command[..., 0]).sin()
        return torch.stack((cos * x - sin * y, sin * x + cos * y), dim=-1)


def embedded(*turns: float) -> TensorDict:
    """A trajectory of 20 slots for each constant turn a slot."""
    turn = torch.tensor(turns)[:, None, None].expand(-1, 20, 1)
    angle = turn * torch.arange(20)[:, None]
    embedding = torch.cat((angle.cos(), angle.sin()), dim=-1)
    return TensorDict({"embedding": embedding, "action": turn}, batch_size=[len(turns), 20])


def skill(share: float, *turns: float) -> dict:
    return skill_over_copying(SimpleNamespace(predictor=Turn(share)), embedded(*turns))


def test_a_perfect_prediction_has_skill_1_and_a_copy_0_with_certainty():
    for share, expected in ((1.0, 1.0), (0.0, 0.0)):
        result = skill(share, 0.1, 0.15, 0.2)
        assert set(result["skill_over_copying"]) == set(result["skill_interval_95"]) == {"1", "5", "10"}
        assert list(result["skill_over_copying"].values()) == pytest.approx([expected] * 3, abs=1e-4)
        assert list(result["skill_interval_95"].values()) == pytest.approx([0] * 3, abs=1e-3)


def test_the_interval_is_the_jackknife_over_trajectories():
    turns = torch.tensor([0.1, 0.2, 0.3, 0.25], dtype=torch.float64)
    result = skill(0.5, *turns.tolist())
    error, copied = 1 - (0.5 * 5 * turns).cos(), 1 - (5 * turns).cos()
    assert result["skill_over_copying"]["5"] == pytest.approx(float(1 - error.mean() / copied.mean()), abs=1e-4)
    left = torch.stack([1 - error[keep].mean() / copied[keep].mean() for keep in ~torch.eye(4, dtype=torch.bool)])
    half = stats.t.ppf(0.975, 3) * float((3 / 4 * (left - left.mean()).square().sum()).sqrt())
    assert result["skill_interval_95"]["5"] == pytest.approx(half, rel=1e-2)


def test_one_trajectory_has_no_interval():
    assert skill(0.5, 0.1)["skill_interval_95"]["10"] is None


def test_an_encoder_that_sees_no_difference_has_no_skill():
    assert set(skill(0.5, 0.0, 0.0)["skill_over_copying"].values()) == {None}


def test_numbers_of_a_command_that_never_change_do_not_make_its_error_smaller():
    spec = PlantSpec(action_low=(-1.0, 2.5), action_high=(1.0, 3.5), slot=0.1, frame=(64, 64))
    action = torch.stack((torch.linspace(-1, 1, 9), torch.full((9,), 3.0)), dim=1)
    rows = TensorDict({"embedding": action, "action": action}, batch_size=[9])
    model = SimpleNamespace(spec=spec, act=lambda embedding, reference: embedding + torch.tensor([0.5, 0.0]))
    assert command_error(model, rows)["command_nmae"] == pytest.approx(0.25)
    rows["action"] = action[:1].expand(9, -1)  # nothing changes: all of it counts
    model.act = lambda embedding, reference: rows["action"] + torch.tensor([0.5, 0.0])
    assert command_error(model, rows)["command_nmae"] == pytest.approx(0.125)
