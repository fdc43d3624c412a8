"""The downlink: what is applied when commands are lost, late or seldom, and when a buffer of them is played."""

import pytest
import torch
from linear_fleet import A, B, LinearFleet
from torchrl.envs import Compose, TransformedEnv

from tsjepa.envs.transforms import Actuator, Estimator, Scheduler, Uplink, linear_model
from tsjepa.radio.delay import ConstantDelay

GAIN = torch.tensor([[-0.6, -1.5]])
POLICY_SLOTS = 60


def planned(length):
    """The law u = K x, and what it will be on the plant's own equations."""

    def policy(td):
        state, plan = td["state"], []
        for _ in range(length):
            plan.append(state @ GAIN.mT)
            state = state @ A.mT + plan[-1] @ B.mT
        return td.set("action", plan[0]).set("plan", torch.stack(plan, -2))

    return policy


def rollout(*transforms, length=1, slots=POLICY_SLOTS, devices=5, lengths=None):
    env = TransformedEnv(LinearFleet((devices,), lengths), Compose(*transforms))
    return env.rollout(slots, planned(length), break_when_any_done=False)


def test_a_downlink_that_loses_nothing_changes_nothing():
    free, through = rollout(Scheduler("oracle", 1)), rollout(Scheduler("oracle", 1), Actuator())
    assert torch.equal(free["state"], through["state"])
    assert torch.equal(through["next", "applied_command"], through["action"])
    assert (through["applied_command"][:, 0] == 0).all()


def test_a_lost_command_leaves_the_one_before():
    data = rollout(Actuator(loss=0.4, seed=1), devices=40)
    applied, action = data["next", "applied_command"], data["action"]
    before = data["applied_command"]
    heard = (applied == action).squeeze(-1)
    assert heard.double().mean().item() == pytest.approx(0.6, abs=0.03)
    assert torch.equal(applied[~heard], before[~heard])
    torch.testing.assert_close(data["next", "state"], data["state"] @ A.mT + applied @ B.mT)


def test_silent_slots_hold_the_last_command():
    data = rollout(Actuator(every=4))
    sent = torch.arange(POLICY_SLOTS) // 4 * 4
    assert torch.equal(data["next", "applied_command"], data["action"][:, sent])


def test_a_buffer_as_long_as_the_silence_loses_nothing_where_the_prediction_is_exact():
    free = rollout(Scheduler("oracle", 1))
    covered = rollout(Actuator(every=4, buffer=4), length=4)
    torch.testing.assert_close(covered["state"], free["state"], atol=1e-4, rtol=1e-4)
    short = rollout(Actuator(every=4, buffer=2), length=2)
    assert (short["state"] - free["state"]).abs().max() > 0.01


def test_used_up_buffers_hold_their_last_command():
    data = rollout(Actuator(every=6, buffer=3), length=3)
    slot = torch.arange(POLICY_SLOTS)
    expected = data["plan"][:, slot // 6 * 6, (slot % 6).clamp(max=2)]
    assert torch.equal(data["next", "applied_command"], expected)


def test_a_late_packet_is_entered_at_the_command_of_this_slot():
    data = rollout(Actuator(delay=ConstantDelay(2), buffer=3), length=3)
    applied = data["next", "applied_command"]
    assert (applied[:, :2] == 0).all()
    assert torch.equal(applied[:, 2:], data["plan"][:, :-2, 2])


def test_episodes_begin_at_rest():
    data = rollout(Actuator(delay=ConstantDelay(2)), lengths=[5, 7, 4, 9, 6])
    assert (data["next", "applied_command"][data["slot"] < 2] == 0).all()


def test_the_estimator_predicts_with_what_was_sent_or_with_what_was_applied():
    """Told the first state alone; the prediction is exact if and only if the controller knows what was applied."""

    def beliefs(**options):
        estimator = Estimator(linear_model(A, B), in_key="state")
        heard_once = (Scheduler("once", 1), Uplink(in_key=None, lossless=True))
        return rollout(*heard_once, Actuator(**options), estimator)

    told = beliefs(loss=0.4, acknowledged=True)
    torch.testing.assert_close(told["belief"], told["state"], atol=1e-3, rtol=1e-3)
    untold = beliefs(loss=0.4)
    assert (untold["belief"] - untold["state"]).abs().max() > 0.05
    for options in ({}, {"every": 4}):  # in a silent slot nothing is sent, and what was sent before is held
        lossless = beliefs(**options)
        torch.testing.assert_close(lossless["belief"], lossless["state"], atol=1e-3, rtol=1e-3)


def test_a_buffer_needs_a_plan_of_its_length():
    with pytest.raises(KeyError, match="policy that plans"):
        env = TransformedEnv(LinearFleet((2,)), Compose(Actuator(buffer=3)))
        env.rollout(2, lambda td: td.set("action", torch.zeros(2, 1)))
    with pytest.raises(ValueError, match="plan has 2 commands"):
        rollout(Actuator(buffer=3), length=2)
