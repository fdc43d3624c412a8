"""A fleet whose setting changes goes on; a push is a push; who has failed starts anew."""

import errno
import os
import socket
from dataclasses import replace

import numpy as np
import pytest
import tiny_controller
import torch

from tsjepa.envs import Radio
from tsjepa.envs.settings import Downlink
from tsjepa.evaluation.rollouts import Loop
from tsjepa.models import Observer
from tsjepa.plants import CartPole
from tsjepa.radio import GilbertElliott, IidLoss
from tsjepa.radio.delay import ConstantDelay
from tsjepa.watch.command import check_port, first_setting, watch
from tsjepa.watch.fleet import DOWN_S, PUSH_SLOTS, RunningFleet
from tsjepa.watch.setting import Setting

PLANT = CartPole()
SLOT = PLANT.spec.slot
SETTING = Setting(devices=4, snr_db=20.0, loss=0.0, scheduler="round_robin", codec="fp32")


def fleet(controller="linear", setting=SETTING, resource_blocks=2) -> RunningFleet:
    radio = Radio(resource_blocks=resource_blocks)
    return RunningFleet(Loop(PLANT, controller, slots=2**31, radio=radio, frame_history=2), setting)


def run(running: RunningFleet, slots: int) -> RunningFleet:
    for _ in range(slots):
        running.slot()
    return running


@pytest.mark.parametrize("devices", [2, 4, 6])
def test_machines_and_beliefs_go_on_when_the_setting_changes(devices):
    running = run(fleet(tiny_controller.tiny()), 5)
    before = running.now.clone()
    running.change(replace(SETTING, devices=devices, snr_db=5.0, scheduler="max_age", codec="fp16"))
    both = min(devices, 4)
    assert running.now.shape == (devices,)
    for key in ("physics_state", "scene", "belief", "slot", "age_of_information"):
        assert torch.equal(running.now[key][:both], before[key][:both]), key
    assert running.snapshot().setting == replace(
        SETTING, devices=devices, snr_db=5.0, scheduler="max_age", codec="fp16"
    )
    assert run(running, 2).snapshot().slot == 7


def test_what_devices_remember_goes_on_with_them():
    model = tiny_controller.tiny()
    model.observer = Observer(model.embedding_dim, gain=0.6)
    running = run(fleet(model), 5)
    before = running.now.clone()
    running.change(replace(SETTING, snr_db=5.0))
    assert torch.equal(running.now["device_belief"], before["device_belief"])
    first = fleet(model).now["device_belief"]
    assert not torch.allclose(first, before["device_belief"])


def test_the_radio_is_as_the_sliders_say():
    running = fleet()
    assert run(running, 20).snapshot().age.max() == 2  # two of four in turn, 15 dB above the threshold
    running.change(replace(SETTING, loss=1.0))
    lost = run(running, 20).snapshot()
    assert lost.age.min() >= 20
    assert lost.sent.all()
    assert not lost.delivered.any()
    running.change(replace(SETTING, scheduler="none"))
    assert not run(running, 5).snapshot().sent.any()


def test_a_codec_of_more_bits_raises_the_rate():
    rates = {codec: run(fleet(setting=replace(SETTING, codec=codec)), 50).bit_rate for codec in ("fp32", "fp16")}
    assert rates["fp32"] == pytest.approx(2 * rates["fp16"])
    steady = 2 * 4 * 32 / SLOT  # two devices, four numbers
    assert rates["fp32"] == pytest.approx(steady * (1 - (1 - SLOT / 2) ** 50))


def test_a_setting_that_cannot_be_is_refused_and_the_fleet_goes_on():
    model = tiny_controller.tiny()
    model.code_low.fill_(float("nan"))
    running = fleet(model)
    running.change(replace(SETTING, codec="int8"))
    assert "needs ranges" in running.snapshot().complaint
    assert run(running, 2).snapshot().setting == SETTING
    running.change(replace(SETTING, codec="fp16"))
    assert running.snapshot().complaint == ""


def test_a_snapshot_says_who_has_sent_since_the_one_before():
    running = fleet(resource_blocks=1)
    assert run(running, 1).snapshot().sent.sum() == 1
    assert run(running, 3).snapshot().sent.sum() == 3
    assert run(running, 4).snapshot().sent.sum() == 4
    assert running.snapshot().sent.sum() == 0


def test_a_push_gives_one_machine_the_momentum_of_the_largest_command_and_nobody_is_told():
    running = run(fleet(), 3)
    before = running.now.clone()
    running.push(1)
    others = torch.tensor([0, 2, 3])
    assert torch.equal(running.now["physics_state"][others], before["physics_state"][others])
    assert torch.equal(running.now["belief"], before["belief"])
    gained = (running.now["physics_state"] - before["physics_state"])[1]
    # 20 N for one and a half slots on 1.1 kg, of which the pole's .1 kg is moved by half
    force, mass = PLANT.spec.action_high[0], 1.1
    assert float(gained[2]) == pytest.approx(force * PUSH_SLOTS * SLOT / mass, rel=0.1)
    assert float(gained[3]) < 0  # the pole falls behind
    running.push(9)  # a device that has gone
    assert torch.equal(running.now["physics_state"][others], before["physics_state"][others])


def test_who_has_failed_is_shown_as_failed_and_starts_anew():
    running = fleet("hold", replace(SETTING, scheduler="none"))
    failed, episodes = [], []
    for _ in range(250):
        running.slot()
        failed.append(running.snapshot().failed.copy())
        episodes.append(running.now["episode"].numpy().copy())
    failed, episodes = np.array(failed), np.array(episodes)
    assert (episodes[0] == 0).all()
    assert (episodes[-1] >= 1).all()
    for device in range(4):
        anew = int(episodes[:, device].argmax())  # the first slot of the next episode
        first = int(failed[:, device].argmax())
        assert (anew - first + 1) * SLOT >= DOWN_S
        assert not failed[anew, device]
    assert (running.snapshot().score < 0.5).all()


@pytest.mark.parametrize(("loss", "slider"), [(None, 0.0), (IidLoss(0.3), 0.3)])
def test_the_sliders_stand_as_the_radio_says(loss, slider):
    radio = Radio(snr_target_db=7.0, codec="fp16", loss=loss)
    assert first_setting(Loop(PLANT, "linear", "max_age", 3, radio=radio)) == Setting(3, 7.0, slider, "max_age", "fp16")


@pytest.mark.parametrize(
    ("radio", "named"),
    [
        (Radio(lossless=True), "neither lossless nor trace"),
        (Radio(snr_target_db=(5.0, 10.0)), "one snr_target_db"),
        (Radio(loss=GilbertElliott(0.1, 0.3)), "loss is a GilbertElliott"),
    ],
)
def test_a_radio_that_sliders_cannot_set_is_refused(radio, named):
    with pytest.raises(ValueError, match=named):
        first_setting(Loop(PLANT, "linear", num_devices=3, radio=radio))


def test_a_port_that_cannot_be_had_is_named_with_the_reason(monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(OSError, match=os.strerror(errno.EADDRINUSE)):
            check_port(taken.getsockname()[1])

    def forbidden(*_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(socket.socket, "bind", forbidden)
    with pytest.raises(OSError, match=rf"port 80 .*{os.strerror(errno.EACCES)}.*--port"):
        check_port(80)


@pytest.mark.parametrize("port", [0, 65536])
def test_a_port_that_is_none_is_refused(port):
    with pytest.raises(ValueError, match=f"port is {port}"):
        watch(port=port)


@pytest.mark.parametrize("downlink", [{}, {"downlink": Downlink(delay=ConstantDelay(2), buffer=2)}])
def test_a_fleet_goes_on_over_a_radio_that_delays(downlink):
    radio = Radio(resource_blocks=2, delay=ConstantDelay(2), **downlink)
    running = RunningFleet(Loop(PLANT, "linear", slots=2**31, radio=radio, frame_history=2), SETTING)
    run(running, 40)
    running.change(replace(SETTING, snr_db=15.0))
    received = running.now["received_slot"].clone()
    run(running, 1)
    assert torch.equal(running.now["received_slot"], received)  # what was on its way is gone
    assert 3 <= run(running, 10).snapshot().age.max() <= 6
