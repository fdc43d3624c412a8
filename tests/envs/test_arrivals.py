"""What is late, overtaken or not acknowledged: the uplink beyond the base station."""

import pytest
import torch
from chains import state_chain
from linear_fleet import A, B, LinearFleet
from torchrl.envs import Compose, TransformedEnv

from tsjepa.envs.transforms import Acknowledge, Channel, Codec, Delay, Estimator, Scheduler, Uplink, linear_model
from tsjepa.envs.transforms.delay import ACKNOWLEDGED
from tsjepa.envs.transforms.uplink import AT_BASE_STATION
from tsjepa.radio.codecs import FloatCodec
from tsjepa.radio.delay import ConstantDelay, UniformDelay


def late(law, horizon=8, scheduler="oracle"):
    return [
        Scheduler(scheduler, 2),
        Codec(FloatCodec(), in_key="state"),
        Uplink(in_key=None, lossless=True, keys=AT_BASE_STATION),
        Delay(law, horizon, seed=3),
    ]


def rollout(transforms, slots=30, devices=6, lengths=None):
    env = TransformedEnv(LinearFleet((devices,), lengths), Compose(*transforms))
    policy = lambda td: td.set("action", -0.5 * td["state"][..., :1])  # noqa: E731
    return env.rollout(slots, policy, break_when_any_done=False)


def test_a_constant_delay_shifts_what_is_received_and_the_age_counts_from_the_picture():
    data = rollout(late(ConstantDelay(3)))
    assert torch.equal(data["received"][:, 3:], data["state"][:, :-3])
    assert (data["received"][:, :3] == 0).all() and not data["delivered"][:, :3].any()
    assert (data["age_of_information"][:, 3:] == 4).all()
    assert data["age_of_information"][0, :3].tolist() == [2, 3, 4]
    assert (data["packet_delay"][:, 3:] == 3).all()
    # the base station has everything at once
    assert data["decoded"].all() and (data["decoded_age"] == 1).all()


def test_of_packets_that_overtake_each_other_the_newest_wins():
    law = UniformDelay(0, 5)
    data = rollout(late(law), slots=60)
    overtaken = 0
    for device in range(6):
        delays = [int(law.draw(3, torch.tensor(device), torch.tensor(0), torch.tensor(k))) for k in range(60)]
        newest = -1
        for slot in range(60):
            here = max((k for k in range(slot + 1) if k + delays[k] == slot), default=-1)
            assert bool(data["delivered"][device, slot]) == (here > newest)
            overtaken += 0 <= here < newest
            newest = max(newest, here)
            assert int(data["age_of_information"][device, slot]) == slot - newest + 1
            if newest >= 0:
                assert torch.equal(data["received"][device, slot], data["state"][device, newest])
    assert overtaken > 20


def test_a_late_value_is_rolled_forward_through_the_commands_since():
    """With the plant's own equations the belief is the state, however late and in whatever order values arrive."""
    chain = [*late(UniformDelay(0, 5), scheduler="round_robin"), Estimator(linear_model(A, B), horizon=8)]
    data = rollout(chain, slots=60)
    informed = data["informed"]
    assert informed[:, 20:].all() and (data["packet_delay"] > 2).any()
    torch.testing.assert_close(data["belief"][informed], data["state"][informed], atol=1e-4, rtol=1e-4)


def test_what_is_on_its_way_does_not_outlive_the_episode():
    data = rollout(late(ConstantDelay(2)), lengths=[5, 7, 4, 9, 5, 6])
    assert torch.equal(data["delivered"], data["slot"] >= 2)


def test_what_takes_too_long_is_lost():
    assert not rollout(late(ConstantDelay(4), horizon=4))["delivered"].any()


def test_acknowledgements_that_all_arrive_change_nothing_and_lost_ones_are_missed():
    chain = state_chain(Scheduler("max_age", 2, outcome_keys=ACKNOWLEDGED))
    told = rollout([*chain[:-1], Acknowledge(0.0)], slots=60)
    plain = rollout(state_chain(Scheduler("max_age", 2))[:-1], slots=60)
    for key in ("scheduled", "delivered", "age_of_information"):
        assert torch.equal(told[key], plain[key])
    assert torch.equal(told["acknowledged"], told["delivered"])
    assert torch.equal(told["acknowledged_age"], told["age_of_information"])


def test_whoever_hears_of_nothing_takes_everybody_for_equally_old():
    chain = [Channel(fading="none"), Scheduler("max_age", 2, outcome_keys=ACKNOWLEDGED)]
    data = rollout([*chain, Uplink(in_key=None), Acknowledge(1.0)])
    assert data["delivered"][:2].all() and not data["scheduled"][2:].any()


def test_half_of_the_acknowledgements():
    data = rollout([Uplink(in_key=None), Acknowledge(0.5)], slots=100, devices=100)
    assert data["delivered"].all()
    assert data["acknowledged"].double().mean().item() == pytest.approx(0.5, abs=0.02)


def test_bad_input_is_rejected():
    with pytest.raises(ValueError, match="horizon 0"):
        Delay(ConstantDelay(1), horizon=0)
    with pytest.raises(ValueError, match="acknowledgement is lost, 2"):
        Acknowledge(2.0)
