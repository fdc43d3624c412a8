"""The radio of a recipe, as the chain that it makes of a fleet of cart-poles."""

import math

import pytest
import tiny_controller
import torch
from tensordict import TensorDict

from tsjepa.envs import Radio, make_env, make_policy
from tsjepa.envs.settings import Downlink
from tsjepa.envs.transforms import Acknowledge, Actuator, Delay, Energy, TraceChannel, Uplink
from tsjepa.plants import CartPole
from tsjepa.radio import SCHEDULERS
from tsjepa.radio.delay import ConstantDelay, GammaDelay, UniformDelay
from tsjepa.radio.energy import EnergyModel
from tsjepa.radio.links import McsLink, ShannonLink
from tsjepa.radio.loss import IidLoss
from tsjepa.radio.posterior import fading_correlation
from tsjepa.support.recipes import parse_arguments

PLANT = CartPole()


def rollout(radio, controller="linear", scheduler="round_robin", slots=30, devices=4):
    env = make_env(PLANT, devices, scheduler, radio, controller)
    return env.rollout(slots, make_policy(PLANT, controller, radio), break_when_any_done=False)


def kinds(radio):
    return [type(transform) for transform in make_env(PLANT, 4, "round_robin", radio, "linear").transform]


def test_a_plain_radio_has_none_of_the_options():
    assert not {Acknowledge, Actuator, Delay, Energy, TraceChannel} & set(kinds(Radio()))


def test_what_is_asked_for_stands_in_the_chain_in_its_order(tmp_path):
    (tmp_path / "trace.csv").write_text("time_s,snr_db,delay_ms\n0,10,30\n1,12,10\n")
    radio = Radio(
        trace=str(tmp_path / "trace.csv"),
        delay="trace",
        ack_loss=0.1,
        energy=EnergyModel(),
        downlink=Downlink(loss=0.1),
    )
    found = kinds(radio)
    order = [found.index(kind) for kind in (TraceChannel, Acknowledge, Delay, Energy, Actuator)]
    assert order == sorted(order)
    data = rollout(radio)
    assert (data["received_slot"] < torch.arange(30))[data["received_slot"] >= 0].any()


def test_the_exact_controller_knows_the_state_though_updates_are_late_and_commands_are_lost():
    """Without noise; it is told what was applied, and rolls late states forward with it."""
    radio = Radio(
        resource_blocks=2,
        lossless=True,
        delay=UniformDelay(0, 3),
        downlink=Downlink(loss=0.3, buffer=5, delay=ConstantDelay(1), acknowledged=True),
    )
    data = rollout(radio, "exact")
    informed = data["informed"]
    assert informed[:, 10:].all() and (data["packet_delay"] > 0).any()
    torch.testing.assert_close(data["belief"][informed], data["state"][informed], atol=1e-3, rtol=1e-3)


@pytest.mark.slow
def test_a_buffer_covers_lost_commands_that_a_holding_actuator_feels():
    """On the true state, without noise, for devices whose first packet arrives: the commands of a lossless downlink."""

    def applied(**downlink):
        radio = Radio(lossless=True, downlink=Downlink(**downlink))
        return rollout(radio, "exact", "oracle", slots=60, devices=10)["next", "applied_command"]

    free, held, played = applied(), applied(loss=0.3), applied(loss=0.3, buffer=20)
    begun = (played == free)[:, 0, 0]
    assert begun.sum() >= 3
    torch.testing.assert_close(played[begun], free[begun], atol=1e-3, rtol=1e-3)
    assert (held - free)[begun].abs().mean() > 0.05


def test_holding_controllers_work_behind_a_downlink_and_have_no_buffer():
    data = rollout(Radio(resource_blocks=2, downlink=Downlink(loss=0.5)), "hold")
    sent, applied = data["next", "held_command"], data["next", "applied_command"]
    heard = (sent == applied).squeeze(-1)
    assert torch.equal(applied[:, 1:][~heard[:, 1:]], applied[:, :-1][~heard[:, 1:]])
    assert 0.5 < heard.double().mean() < 0.95  # a command that is held is sent again
    with pytest.raises(ValueError, match="buffer of 3 commands needs a controller that predicts"):
        make_policy(PLANT, "hold", Radio(downlink=Downlink(buffer=3)))


@pytest.mark.parametrize("acknowledged", [True, False])
def test_a_held_command_is_the_last_one_that_was_sent_however_long_it_travels(acknowledged):
    delayed = Downlink(delay=ConstantDelay(2), acknowledged=acknowledged)
    data = rollout(Radio(resource_blocks=1, lossless=True, downlink=delayed), "hold")
    sent, applied = data["next", "held_command"], data["next", "applied_command"]
    assert torch.equal(applied[:, 2:], sent[:, :-2]) and (applied[:, :2] == 0).all()
    again = ~data["delivered"]
    assert torch.equal(sent[:, 1:][again[:, 1:]], sent[:, :-1][again[:, 1:]])


def test_a_packet_that_its_repetition_saves_fits_into_what_was_granted():
    """The scheduler asks for the units of the threshold; the first attempt alone would need more."""
    radio = Radio(harq_ms=8.0, resource_blocks=None, payload_bits=8192, csi="statistical")
    threshold = 10 ** (radio.snr_threshold_db / 10)
    snr = torch.tensor([0.3, 0.7, 1.2]) * threshold
    again = torch.tensor([0.6, 0.7, 0.0]) * threshold
    current = TensorDict(
        {
            "scheduled": torch.ones(3, dtype=torch.bool),
            "snr": snr,
            "repeated_snr": again,
            "payload_bits": torch.full((3,), 8192),
            "resource_units": radio.demand(torch.tensor(8192), torch.tensor(threshold)).expand(3),
        },
        batch_size=[3],
    )
    uplink = Uplink(radio.snr_threshold_db, in_key=None, demand=radio.demand, repeats=True)
    values = uplink._slot({"age_of_information": torch.ones(3, dtype=torch.int64)}, current, None)
    assert values["delivered"].tolist() == [False, True, True]
    assert values["transmissions"].tolist() == [2, 2, 1]


def test_a_built_in_scheduler_is_the_same_as_a_function_and_by_its_name():
    def sent(scheduler, seed):
        env = make_env(CartPole(process_noise_std=0.01), 4, scheduler, Radio(resource_blocks=1), "linear", seed=seed)
        data = env.rollout(20, make_policy(PLANT, "linear"), break_when_any_done=False)
        return torch.stack((data["scheduled"], data["delivered"]))

    for name in ("oracle", "random", "channel_aware_cost"):
        assert torch.equal(sent(SCHEDULERS[name], 1), sent(name, 1))
    assert sent(SCHEDULERS["oracle"], 0).all()
    assert not torch.equal(sent(SCHEDULERS["random"], 0), sent(SCHEDULERS["random"], 1))


@pytest.mark.parametrize("scheduler", ["round_robin", "urgency"])
def test_devices_that_watch_all_the_time_spend_the_energy_of_every_picture(scheduler):
    model = tiny_controller.tiny()
    radio = Radio(resource_blocks=1, energy=EnergyModel(encode_j=1.0, airtime_s=1e-9))
    data = make_env(PLANT, 3, scheduler, radio, model).rollout(5, make_policy(PLANT, model))
    spent = torch.ones_like(data["energy_j"]) if scheduler == "urgency" else data["scheduled"].float()
    torch.testing.assert_close(data["energy_j"], spent)


def test_a_stream_of_frames_wants_every_device_in_every_slot_and_starts_anew_with_an_episode():
    model = tiny_controller.tiny()

    def env(blocks):
        return make_env(
            PLANT, 2, "round_robin", Radio(resource_blocks=blocks, lossless=True, codec="stream-raw"), model
        )

    with pytest.raises(ValueError, match="every device has to send in every slot"):
        env(1).reset()
    whole = env(2)
    for _ in range(2):
        now = whole.reset()
        assert torch.equal(now["received"], now["pixels"])


def test_grants_of_an_mcs_and_room_for_its_repetition():
    """A state of 128 bits with MCS 4: a unit holds 156 x .6016 = 93 of them, so two are needed; four for two tries."""
    for harq_ms, units in ((None, 2), (8.0, 4)):
        data = rollout(Radio(resource_blocks=None, link=McsLink(4), harq_ms=harq_ms))
        granted = data["resource_units"][data["scheduled"]]
        assert granted.numel() and (granted == units).all()


def test_what_is_believed_of_decoding():
    assert Radio().decoding(None).thresholds == (pytest.approx(10**0.5),)
    assert Radio().decoding(None).repetition is None
    assert Radio(harq_ms=8.0).decoding(None).repetition == 0.0
    walking = Radio(harq_ms=8.0, max_doppler_hz=10.4239).decoding(None).repetition
    assert walking == pytest.approx(float(fading_correlation(0.008, 10.4239)))
    assert len(Radio(link=McsLink(4)).decoding(128).thresholds) == 16


RECIPE = """
radio:
  link: {mcs: 4}
  delay: {shift: 5.0, mean_excess: 10.0}
  downlink: {loss: 0.3, every: 2, buffer: 10, delay: {low: 0, high: 2}}
  energy: {encode_j: 0.005}
"""


def of_recipe(text, tmp_path):
    def wanted(radio: Radio = Radio()):  # noqa: B008 - frozen
        return radio

    path = tmp_path / "recipe.yaml"
    path.write_text(text)
    return parse_arguments(wanted, ["--config", str(path)], "test")["radio"]


def test_a_recipe_names_every_part_by_its_fields(tmp_path):
    radio = of_recipe(RECIPE, tmp_path)
    assert radio.link == McsLink(4) and radio.energy == EnergyModel(0.005)
    assert radio.delay == GammaDelay(5.0, 10.0)
    assert radio.downlink == Downlink(0.3, UniformDelay(0, 2), every=2, buffer=10)
    assert of_recipe("radio: {link: {gap_db: 3.0}}", tmp_path).link == ShannonLink(3.0)
    assert of_recipe("radio: {delay: {value: 2}}", tmp_path).delay == ConstantDelay(2)


def test_an_option_that_no_part_has_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        of_recipe("radio: {link: {modulation: 4}}", tmp_path)
    assert "modulation" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"link": McsLink(None)}, "MCS that follows the SNR"),
        ({"link": McsLink(None), "resource_blocks": None, "csi": "delayed"}, "MCS that follows the SNR"),
        ({"harq_ms": 0.0}, "harq_ms 0"),
        ({"delay": "trace"}, "delay 'trace'"),
        ({"trace": "a.csv", "interference_rise_db": 1.0}, "A trace is played as it is"),
        ({"trace": "a.csv", "loss": IidLoss(0.5)}, "leave lossless, loss, harq_ms"),
        ({"lossless": True, "resource_blocks": None}, "give resource_blocks, or leave lossless out"),
        ({"link": McsLink(4), "payload_bits": (128, 512)}, "an MCS takes one number of bits"),
        ({"ack_loss": 1.5}, "ack_loss"),
        ({"interference_rise_db": -1.0}, "interference_rise_db"),
        *(({"bandwidth_mhz": value}, f"bandwidth_mhz is {value}") for value in (-100.0, 0.0, math.nan, math.inf)),
        *(({"trace_stretch": value}, f"trace_stretch is {value}") for value in (-1.0, 0.0, math.nan, math.inf)),
        *(({"trace_start_s": value}, f"trace_start_s is {value}") for value in (-1.0, math.nan, math.inf)),
    ],
)
def test_what_cannot_be_is_refused(options, named):
    with pytest.raises(ValueError, match=named):
        Radio(**options)


@pytest.mark.parametrize("options", [{"loss": 1.2}, {"every": 0}, {"buffer": 0}])
def test_a_downlink_that_cannot_be_is_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        Downlink(**options)
