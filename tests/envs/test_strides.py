"""A predictor of several strides in the chain."""

import pytest
import tiny_controller
import torch
from linear_fleet import A, B, LinearFleet
from torch import nn
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from tsjepa.envs import Radio, make_env, make_policy
from tsjepa.envs.transforms import Channel, Codec, HierarchicalEstimator, Scheduler, Uplink
from tsjepa.models import HierarchicalPredictor
from tsjepa.plants import CartPole
from tsjepa.radio.codecs import FloatCodec
from tsjepa.radio.delay import ConstantDelay


class Exact(nn.Module):
    """The linear fleet's own equations over a stride."""

    def forward(self, state, commands):
        for command in commands.split(1, -1):
            state = state @ A.mT + command @ B.mT
        return state


def exact(strides=(1, 2, 6)) -> HierarchicalPredictor:
    predictor = HierarchicalPredictor(2, [4] * len(strides), strides)
    predictor.levels = nn.ModuleList(Exact() for _ in strides)
    return predictor


def fleet(predictor, lengths=None) -> TransformedEnv:
    chain = [Channel(snr_target_db=3.0), Scheduler("round_robin", 1), Codec(FloatCodec(), in_key="state"), Uplink()]
    return TransformedEnv(LinearFleet((4,), lengths), Compose(*chain, HierarchicalEstimator(predictor)))


def test_exact_strides_believe_the_state_whatever_the_age():
    policy = lambda td: td.set("action", -0.5 * td["state"][..., :1])  # noqa: E731
    data = fleet(exact()).rollout(60, policy, break_when_any_done=False)
    informed = data["informed"]
    assert data["age_of_information"].max() > 12 and informed[:, 30:].all()
    torch.testing.assert_close(data["belief"][informed], data["state"][informed], atol=1e-4, rtol=1e-4)
    assert torch.equal(data["predicted_slots"] == 0, data["delivered"] | (data["slot"] == 0))


def test_specs():
    check_env_specs(fleet(exact(), lengths=[3, 9, 5, 20]), break_when_any_done="both")


def model():
    controller = tiny_controller.tiny()
    torch.manual_seed(0)
    controller.predictor = HierarchicalPredictor(tiny_controller.DIM, (16, 16, 16))
    return controller


def test_a_model_with_strides_runs_in_the_chain_and_believes_what_its_roll_out_says():
    plant, controller = CartPole(), model()
    env = make_env(plant, 3, "once", Radio(lossless=True), controller, slots=30)
    data = env.rollout(30, make_policy(plant, controller), break_when_any_done=False)
    told = controller.predictor.ahead(data["belief"][:, 0], data["action"][:, :-1])
    torch.testing.assert_close(data["belief"][:, 1:], told, atol=1e-5, rtol=1e-4)


def test_what_strides_cannot_do_is_said():
    with pytest.raises(ValueError, match="several strides"):
        make_env(CartPole(), 3, radio=Radio(delay=ConstantDelay(1)), controller=model())
    with pytest.raises(ValueError, match="several strides"):
        make_env(CartPole(), 3, radio=Radio(), controller=model(), blend=0.5)
    with pytest.raises(ValueError, match="several strides"):
        make_env(CartPole(), 3, "urgency", Radio(), model())
