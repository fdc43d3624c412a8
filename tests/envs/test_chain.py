"""What the chain does: who is served, what arrives, what is believed and what is applied."""

import math

import pytest
import torch
from chains import embed, integer_codec, state_chain, whole_chain
from linear_fleet import A, B, LinearFleet, render
from torchrl.envs import Compose, TransformedEnv

from tsjepa.envs.transforms import Camera, Channel, Encode, Estimator, HoldCommand, Scheduler, Uplink
from tsjepa.radio import GilbertElliott, IidLoss, outage_probability, periodic, resource_units

BURSTS = GilbertElliott(0.05, 0.2)


def feedback(tensordict):
    return tensordict.set("action", -tensordict["state"][..., :1])


def rollout(transforms, slots=40, batch_size=(6,), lengths=None, policy=feedback):
    env = TransformedEnv(LinearFleet(batch_size, lengths), Compose(*transforms))
    return env.rollout(slots, policy, break_when_any_done=False)


def test_channel_statistics():
    channel = Channel(snr_target_db=10.0)
    data = rollout([channel, Uplink(in_key=None)], slots=200, batch_size=(200,))
    torch.testing.assert_close(data["mean_snr"], torch.full_like(data["mean_snr"], 10.0))
    expected = outage_probability(10**0.5, 10.0).item()
    error = math.sqrt(expected * (1 - expected) / data["delivered"].numel())
    assert (~data["delivered"]).double().mean().item() == pytest.approx(expected, abs=4 * error)


def test_large_scale_is_kept_within_an_episode_and_redrawn_after():
    data = rollout([Channel()], slots=30, lengths=[10] * 6)
    loss = data["path_loss_db"]
    assert torch.equal(data["channel_slot"][0], torch.arange(30) % 10)
    assert torch.equal(data["channel_episode"][0], torch.arange(30) // 10)
    for start in (0, 10, 20):
        assert (loss[:, start : start + 10] == loss[:, start : start + 1]).all()
    assert (loss[:, 0] != loss[:, 10]).all()


def test_two_schedulers_see_the_same_channel():
    first = rollout(state_chain(Scheduler("round_robin", 2)))
    second = rollout(state_chain(Scheduler("channel_aware", 2)))
    assert torch.equal(first["snr"], second["snr"])
    assert not torch.equal(first["scheduled"], second["scheduled"])
    other = rollout(state_chain(channel=Channel(snr_target_db=8.0, seed=1)))
    assert not torch.equal(first["snr"], other["snr"])


def test_a_second_reset_goes_on_to_the_next_episode():
    env = TransformedEnv(LinearFleet(), Compose(Channel()))
    first, second = env.reset(), env.reset()
    assert (second["channel_episode"] == first["channel_episode"] + 1).all()
    assert not torch.equal(first["snr"], second["snr"])


@pytest.mark.parametrize("max_doppler_hz", [0.0, 10.0])
def test_resetting_some_devices_leaves_the_others_bit_identical(max_doppler_hz):
    """Everything but the shared resource: with J = I the schedule does not couple the devices either."""

    def chain():
        channel = Channel(snr_target_db=8.0, max_doppler_hz=max_doppler_hz, loss=IidLoss(0.1))
        return [channel, Scheduler("max_age", resource_blocks=6), *whole_chain()[2:]]

    quiet = rollout(chain(), lengths=[1000] * 6)
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        resetting = torch.rand(6, generator=generator) < 0.5
        lengths = torch.where(resetting, torch.randint(2, 20, (6,), generator=generator), 1000)
        noisy = rollout(chain(), lengths=lengths)
        for key in noisy.keys(include_nested=True, leaves_only=True):
            if key not in ("scheduler_memory", ("next", "scheduler_memory")):
                assert torch.equal(noisy[key][~resetting], quiet[key][~resetting]), key


def test_a_reset_device_starts_anew_and_shares_what_is_left_of_the_slot():
    lengths = [7, 1000, 9, 1000, 13, 1000]
    data = rollout(state_chain(Scheduler("channel_aware", 2)), slots=60, lengths=lengths)
    assert (data["scheduled"].sum(0) <= 2).all()
    started = data["slot"] == 0
    first_age = data["age_of_information"][started]
    assert torch.equal(first_age == 1, data["delivered"][started])
    assert ((first_age == 1) | (first_age == 2)).all()
    unheard = started & ~data["delivered"]
    assert unheard.any() and (data["belief"][unheard] == 0).all()
    # a device that resets may still be served in that very slot
    assert (data["scheduled"] & started)[:, 1:].any()


def test_the_gate_holds_at_resets_too():
    data = rollout(state_chain(Scheduler("channel_aware", 2)), slots=200, lengths=[3, 5, 7, 11, 13, 17])
    assert not (data["scheduled"] & (data["snr"] < 10**0.5)).any()
    assert torch.equal(data["delivered"], data["scheduled"])


def test_age_counts_slots_since_delivery():
    data = rollout(state_chain(Scheduler("random", 2)))
    age = torch.ones(6, dtype=torch.int64)
    for slot in range(40):
        age = torch.where(data["delivered"][:, slot], 1, age + 1)
        assert torch.equal(data["age_of_information"][:, slot], age)
    assert (data["scheduled"] & ~data["delivered"]).any()


def test_round_robin_survives_resets():
    data = rollout([Scheduler("round_robin", 2)], slots=30, lengths=[4, 6, 5, 9, 3, 8])
    assert (data["scheduled"].sum(-1) == 10).float().mean() > 0.3
    steady = rollout([Scheduler("round_robin", 2)], slots=30)
    assert (steady["scheduled"].sum(-1) == 10).all()


def test_periodic_counts_the_slots_of_each_devices_own_episode():
    data = rollout([Scheduler(periodic(3), 1)], slots=30, lengths=[4, 6, 5, 9, 3, 8])
    assert torch.equal(data["scheduled"], data["slot"] % 3 == 0)
    first = rollout([Scheduler("once", 1)], slots=30, lengths=[4, 6, 5, 9, 3, 8])
    assert torch.equal(first["scheduled"], first["slot"] == 0)


def test_units_are_enough_for_the_payload_and_within_the_slot():
    data = rollout(state_chain(Scheduler("max_age", payload_bits=640, units=5)), slots=100)
    units, sent = data["resource_units"], data["scheduled"]
    assert (units.sum(0) <= 5).all()
    assert torch.equal(units > 0, sent)
    # the state takes 64 bits, so a device that pays for 640 is always decoded above the threshold
    assert torch.equal(data["delivered"], sent & (data["snr"] >= 10**0.5))
    good = sent & (data["snr"] >= 10**0.5)
    assert torch.equal(units[good], resource_units(640, data["snr"][good].double()))


def test_an_update_larger_than_its_grant_is_lost():
    data = rollout(state_chain(Scheduler("max_age", payload_bits=1, units=6)), slots=50, batch_size=(3,))
    fits = resource_units(64, data["snr"].double()) <= 1
    assert data["scheduled"].all()
    assert torch.equal(data["delivered"], fits & (data["snr"] >= 10**0.5))


def test_delayed_csi_predicts_the_snr_from_earlier_slots():
    """Opportunistic with one block picks today's best device more often than the best of three slots ago is that."""
    assumed = {"csi": "delayed", "csi_delay": 3, "max_doppler_hz": 2.0}
    channel = Channel(snr_target_db=10.0, max_doppler_hz=2.0)
    data = rollout([channel, Scheduler("opportunistic", 1, **assumed)], slots=100)
    best = data["snr"].argmax(0)
    picked = data["scheduled"].int().argmax(0)
    assert (picked == best)[8:].float().mean() > 0.8 > (best[3:] == best[:-3])[5:].float().mean()
    # nothing is known in the first slots, in which all links are believed alike
    assert (picked[:3] == 0).all()
    now = rollout([Channel(snr_target_db=10.0), Scheduler("opportunistic", 1)])
    assert torch.equal(now["scheduled"].int().argmax(0), now["snr"].argmax(0))


@pytest.mark.parametrize("scheduler", ["channel_aware", "opportunistic", "whittle", "proportional_fair"])
def test_delayed_csi_of_independent_fading_schedules_as_statistical_does(scheduler):
    delayed, statistical = (
        rollout([Channel(tx_power_dbm=-10.0), Scheduler(scheduler, 2, csi=csi), Uplink(in_key=None)])
        for csi in ("delayed", "statistical")
    )
    assert torch.equal(delayed["scheduled"], statistical["scheduled"])


@pytest.mark.parametrize("csi", ["perfect", "delayed", "statistical", "acks"])
def test_the_hidden_state_of_the_losses_is_not_known(csi):
    """With the outcomes kept secret (no Uplink) two channels that differ in their erasures alone schedule alike."""

    def scheduled(loss):
        chain = [Channel(snr_target_db=8.0, loss=loss), Scheduler("channel_aware", 2, csi=csi, loss=BURSTS)]
        return rollout(chain, slots=60)["scheduled"]

    assert torch.equal(scheduled(BURSTS), scheduled(IidLoss(0.0)))


def test_iid_loss_is_seen_by_nobody_and_felt_by_all():
    chain = [Channel(fading="none", loss=IidLoss(0.4)), Uplink(in_key=None)]
    data = rollout(chain, slots=300, batch_size=(50,))
    assert data["delivered"].double().mean().item() == pytest.approx(0.6, abs=0.015)


def test_received_holds_or_drops():
    held = rollout(state_chain(), slots=30)
    sent = held["delivered"]
    assert torch.equal(held["received"][sent], held["state"][sent])
    silent = ~sent[:, 1:]
    assert torch.equal(held["received"][:, 1:][silent], held["received"][:, :-1][silent])
    dropped = rollout(state_chain(when_lost="drop"), slots=30)
    assert (dropped["received"][~dropped["delivered"]] == 0).all()


def test_a_linear_model_predicts_a_linear_plant():
    data = rollout(state_chain(Scheduler("round_robin", 1)), slots=60)
    informed = data["informed"]
    assert informed.any() and not informed.all()
    torch.testing.assert_close(data["belief"][informed], data["state"][informed], atol=1e-4, rtol=1e-4)


def test_blending_mixes_prediction_and_update():
    chain = [*state_chain(Scheduler("oracle", 1), lossless=True)[:-1], Estimator(lambda z, u: z, blend=0.25)]
    data = rollout(chain, slots=20)
    torch.testing.assert_close(data["belief"][:, 0], data["state"][:, 0])
    expected = 0.75 * data["belief"][:, :-1] + 0.25 * data["state"][:, 1:]
    torch.testing.assert_close(data["belief"][:, 1:], expected)


def test_hold_command_repeats_what_was_applied():
    data = rollout([Channel(snr_target_db=8.0), Scheduler("random", 2), Uplink(in_key=None), HoldCommand()])
    applied = data["next", "held_command"]
    sent = data["delivered"]
    assert torch.equal(applied[sent], data["action"][sent])
    assert torch.equal(applied[~sent], data["held_command"][~sent])
    assert (data["held_command"][:, 0] == 0).all()
    torch.testing.assert_close(data["next", "state"], data["state"] @ A.mT + applied @ B.mT)


def test_the_camera_sees_scheduled_devices_at_the_right_slots():
    chain = [Scheduler("round_robin", 2), Camera(render, (4, 8), 2, 2), Encode(embed, 12)]
    data = rollout(chain, slots=12, policy=lambda td: td.set("action", torch.zeros(6, 1)))
    pixels, sent = data["pixels"], data["scheduled"]
    assert (pixels[~sent] == 0).all() and (data["embedding"][~sent] == 0).all()
    position = data["scene"][..., [0, 2], 0].mul(100).round().clamp(0, 255).to(torch.uint8)
    assert torch.equal(pixels[sent][:, :, 0, 0, 0], position[sent])
    assert (pixels[sent][:, :, 0, 1] == 50).all()
    torch.testing.assert_close(data["embedding"][sent], embed(pixels[sent]))


def test_payload_is_quantised_and_counted():
    data = rollout(whole_chain(), slots=20)
    sent = data["scheduled"]
    assert (data["payload_bits"][sent] == 12 * 8).all() and (data["payload_bits"][~sent] == 0).all()
    codec = integer_codec(12)
    torch.testing.assert_close(data["payload"][sent], codec.decode(codec.encode(data["embedding"][sent])))


def test_codec_ranges_travel_with_the_env():
    env = TransformedEnv(LinearFleet(), Compose(*whole_chain()))
    saved = env.state_dict()
    assert any(key.endswith("codec.low") for key in saved)
    env.load_state_dict(saved)
