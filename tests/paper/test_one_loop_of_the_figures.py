"""The chain against the figures' own loop, which it replaces: the same commands, states and bits, bit for bit."""

import pytest
import torch

import tsjepa
from tsjepa.envs import Radio
from tsjepa.evaluation.closed_loop import Starts
from tsjepa.evaluation.closed_loop import run as run_alone
from tsjepa.evaluation.rollouts import Loop, every, run
from tsjepa.paper import loops, rows
from tsjepa.plants import CartPole
from tsjepa.radio import IidLoss

COUNT, SLOTS = 3, 20
SUPERVISED = "supervised-cartpole-k2"
CODECS = {"stack": "{}", "stream": "stream-{}", "video": "stream-h264", "embedding": "{}", "state": "{}"}


def both(point, radio=None):
    """States, commands and bits of the figures' loop and of the chain."""
    point = {"starts": COUNT, "slots": SLOTS, "process_noise_std": 0.0, "quality": None, "seeds": 2} | point
    model = point["model"] and tsjepa.load(point["model"])
    loop = Loop(
        CartPole(),
        model or point["between"],
        num_devices=COUNT,
        slots=SLOTS,
        frame_history=4,
        between=point["between"] if model else None,
        radio=radio
        or Radio(codec=CODECS[point["sends"]].format(point["codec"]), quality=point["quality"] or 50, lossless=True),
    )
    return point, every(loop, point["update_every"])


@pytest.mark.parametrize(
    "point",
    [
        {"model": None, "sends": "state", "codec": "int8", "update_every": 1, "between": "hold"},
        {"model": None, "sends": "state", "codec": "fp32", "update_every": 5, "between": "zero"},
        {"model": SUPERVISED, "sends": "stack", "codec": "raw", "update_every": 2, "between": "hold"},
        {"model": SUPERVISED, "sends": "stack", "codec": "webp", "update_every": 1, "between": "hold"},
        {"model": SUPERVISED, "sends": "stream", "codec": "png", "update_every": 1, "between": "hold"},
        {"model": SUPERVISED, "sends": "stream", "codec": "jpeg", "quality": 80, "update_every": 1, "between": "hold"},
        {"model": SUPERVISED, "sends": "video", "codec": "h264", "quality": 20, "update_every": 1, "between": "hold"},
        {
            "model": "tsjepa-cartpole-d16",
            "sends": "embedding",
            "codec": "int4",
            "update_every": 1,
            "between": "predict",
        },
        {
            "model": "tsjepa-cartpole-d16",
            "sends": "embedding",
            "codec": "fp16",
            "update_every": 5,
            "between": "predict",
        },
        {"model": "tsjepa-cartpole-d16", "sends": "embedding", "codec": "fp32", "update_every": 3, "between": "hold"},
        {
            "model": "tsjepa-cartpole-d16",
            "sends": "embedding",
            "codec": "fp32",
            "update_every": 0,
            "between": "predict",
        },
    ],
)
def test_what_a_device_sends(point):
    point, loop = both(point)
    policy = loops.RemotePolicy(point, 1)
    state, action = run_alone(Starts(1, COUNT, SLOTS, 4), policy)
    ours = run(loop, 1)
    torch.testing.assert_close(ours.action, action, rtol=0, atol=0)
    torch.testing.assert_close(ours.state, state, rtol=0, atol=0)
    assert int(ours.payload_bits.sum()) == policy.bits


@pytest.mark.parametrize("period", [1, 3])
def test_losses(monkeypatch, period):
    point = {"model": "tsjepa-cartpole-d16", "sends": "embedding", "codec": "fp32", "between": "predict", "loss": 0.4}
    radio = Radio(codec="fp32", snr_target_db=100, snr_threshold_db=-100, loss=IidLoss(0.4), resource_blocks=COUNT)
    point, loop = both(point | {"update_every": period}, radio)
    ours = run(loop, 1)
    arrived = iter(ours.delivered[::period])
    assert 0.3 < ours.delivered[::period].float().mean() < 0.9
    monkeypatch.setattr(torch, "rand", lambda *sizes, **options: next(arrived).float())
    state, action = run_alone(Starts(1, COUNT, SLOTS, 4), loops.RemotePolicy(point, 1))
    torch.testing.assert_close(ours.action, action, rtol=0, atol=0)
    torch.testing.assert_close(ours.state, state, rtol=0, atol=0)


@pytest.mark.parametrize(
    "point",
    [
        {"model": None, "sends": "state", "codec": "fp32", "update_every": 5, "between": "hold"},
        {"model": None, "sends": "state", "codec": "fp32", "update_every": 0, "between": "zero"},
        {"model": SUPERVISED, "sends": "stack", "codec": "raw", "update_every": 2, "between": "hold"},
        {"model": "tsjepa-cartpole-d16", "sends": "embedding", "codec": "fp32", "update_every": 1, "between": "hold"},
        {"model": "tsjepa-cartpole-d16", "sends": "embedding", "codec": "fp32", "update_every": 0, "between": "zero"},
        {
            "model": "tsjepa-cartpole-d16",
            "sends": "embedding",
            "codec": "int8",
            "update_every": 5,
            "between": "predict",
        },
        {
            "model": "tsjepa-cartpole-d16",
            "sends": "embedding",
            "codec": "fp32",
            "update_every": 0,
            "between": "predict",
        },
    ],
)
def test_commands_while_the_expert_drives(point):
    point = {"starts": COUNT, "slots": SLOTS, "process_noise_std": 0.0, "quality": None, "seeds": 2} | point
    starts = loops.starts_of(point, 1)
    policy, expert, commands = loops.RemotePolicy(point, 1), CartPole().experts()["expert"], []

    def driver(slot, observation):
        commands.append(policy(slot, observation))
        return expert(observation["state"])

    state, action = run_alone(starts, driver)
    ours = rows.driven(rows.loop_of(point), 1)
    torch.testing.assert_close(ours.state, state, rtol=0, atol=0)
    torch.testing.assert_close(ours.action, torch.stack(commands), rtol=0, atol=0)
    torch.testing.assert_close(ours.expert_action, action, rtol=0, atol=0)
    error = loops.command_error(starts, loops.RemotePolicy(point, 1))
    assert rows.command_rows(point)[1]["nmae_by_slot"] == loops.thinned(error)


def test_rows_of_the_chain_are_those_of_the_first_loop():
    point = {"model": None, "sends": "state", "codec": "int8", "update_every": 2, "between": "hold", "seeds": 2}
    point |= {"starts": 8, "slots": 100, "process_noise_std": 0.0}
    row = rows.loop_rows(point)[1]
    policy = loops.RemotePolicy(point, 1)
    state, action = run_alone(loops.starts_of(point, 1), policy)
    inside = (state[1:, :, 0].abs() <= 0.05) & (state[1:, :, 1].abs() <= 0.05)
    assert row["raw_score"] == float(inside.float().mean(0).mean())
    assert row["in_box"] == loops.thinned(inside.float().mean(1))
    assert row["bits_per_slot"] == policy.bits / 800
