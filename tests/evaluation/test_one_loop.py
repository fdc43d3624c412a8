"""The chain against the loop that it replaces: the same commands and states, bit for bit."""

import pytest
import torch

import tsjepa
from tsjepa.envs import Radio
from tsjepa.envs.payload import embedding_codec
from tsjepa.evaluation.closed_loop import SemanticPolicy, Starts, true_state_policy
from tsjepa.evaluation.closed_loop import run as run_alone
from tsjepa.evaluation.rollouts import Loop, every, run
from tsjepa.plants import CartPole

COUNT, SLOTS = 4, 24


@pytest.mark.parametrize("noise", [0.0, 0.008])
@pytest.mark.parametrize("period", [1, 2, 5, 10, 20, 0])
@pytest.mark.parametrize(
    "name", ["tsjepa-cartpole-d16", "tsjepa-cartpole", "supervised-cartpole-k4", "autoencoder-cartpole"]
)
@pytest.mark.parametrize(("codec", "blend"), [("fp32", 1.0), ("int8", 1.0), ("fp32", 0.6)])
def test_a_model_in_the_chain_does_what_it_did_alone(name, period, codec, blend, noise):
    model, plant = tsjepa.load(name), CartPole(process_noise_std=noise)
    radio = embedding_codec(codec, model)
    policy = SemanticPolicy(model, plant.render, period, blend, lambda z: radio.decode(radio.encode(z)))
    state, action = run_alone(Starts(3, COUNT, SLOTS, 4, process_noise_std=noise), policy)
    loop = Loop(
        plant,
        model,
        num_devices=COUNT,
        slots=SLOTS,
        radio=Radio(codec=codec, lossless=True),
        frame_history=4,
        blend=blend,
    )
    ours = run(every(loop, period), 3)
    torch.testing.assert_close(ours.action, action, rtol=0, atol=0)
    torch.testing.assert_close(ours.state, state, rtol=0, atol=0)


@pytest.mark.parametrize("between", ["hold", "zero"])
@pytest.mark.parametrize("period", [1, 2, 5, 0])
def test_the_expert_in_the_chain_does_what_it_did_alone(between, period):
    plant = CartPole()
    policy = true_state_policy(plant.experts()["reference LQR"], period, between)
    state, action = run_alone(Starts(1, COUNT, SLOTS), policy)
    loop = Loop(plant, between, num_devices=COUNT, slots=SLOTS, expert="reference LQR")
    ours = run(every(loop, period), 1)
    torch.testing.assert_close(ours.action, action, rtol=0, atol=0)
    torch.testing.assert_close(ours.state, state, rtol=0, atol=0)
