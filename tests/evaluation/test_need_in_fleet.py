"""Fleets whose schedulers look at need: from pixels and from states, of unlike devices, and what they are worth."""

from dataclasses import replace

import pytest
import torch
from open_plant import OpenPlant, right_model
from torch import nn

from tsjepa.envs import Radio, make_env
from tsjepa.envs.need import cost_of_age
from tsjepa.envs.settings import Downlink, Requests
from tsjepa.evaluation.fleet_summary import summary
from tsjepa.evaluation.rollouts import Loop, run
from tsjepa.plants import CartPole, Mixed, Pendulum, Reacher
from tsjepa.radio import grant
from tsjepa.radio.cost import age_cost_table

NOISY = OpenPlant(process_noise_std=0.02)
LOOP = Loop(NOISY, "linear", num_devices=6, slots=20, radio=Radio(resource_blocks=2))


class Probe(nn.Module):
    """The state that ``open_plant.lift`` has lifted."""

    def forward(self, embedding):
        return embedding[..., :4] / embedding[..., 4:].clamp_min(1e-6)


def seeing(plant=NOISY):
    model = right_model(plant)
    model.probe = Probe()
    return model


def watched(loop, *keys):
    """[T, I, ...] of each key, and the run."""
    seen = []
    outcome = run(loop, 0, lambda slot, now: seen.append(now.select(*keys)))
    return torch.stack(seen), outcome


@pytest.mark.parametrize("scheduler", ["urgency", "genie", "expected_urgency"])
def test_a_model_that_is_right_needs_what_the_true_state_needs(scheduler):
    """Its embedding is the state, its predictor the plant: against prediction by the plant's own equations."""
    keys = ("expected_gain",) if scheduler == "expected_urgency" else ("urgency", "true_error")
    from_pixels, _ = watched(replace(LOOP, scheduler=scheduler, controller=seeing()), *keys)
    from_states, _ = watched(replace(LOOP, scheduler=scheduler, controller="exact"), *keys)
    for key in keys:
        torch.testing.assert_close(from_pixels[key], from_states[key], atol=2e-3, rtol=0.02)


def test_cameras_run_all_the_time_only_where_devices_watch():
    for scheduler, always in (
        ("urgency", True),
        ("first_contact", True),
        ("expected_urgency", False),
        ("channel_aware", False),
    ):
        model = seeing()
        seen, _ = watched(replace(LOOP, scheduler=scheduler, controller=model), "embedding", "scheduled")
        looked = seen["embedding"].abs().sum(-1) > 0
        assert looked.all() if always else torch.equal(looked, seen["scheduled"])
        assert model.encoder.given[3].shape[0] == (6 if always else seen["scheduled"][3].sum())


def test_the_urgency_of_a_state_is_the_experts_command_before_it_saturates():
    seen, _ = watched(replace(LOOP, scheduler="genie", controller="linear"), "true_error", "state")
    expert = NOISY.experts()["expert"]
    first = (expert.unsaturated(seen["state"][0]) / 40.0).abs()[:, 0].double()
    torch.testing.assert_close(seen["true_error"][0], first)
    assert first.max() > 0.5  # more than the actuator has
    told = expert.unsaturated(torch.tensor([[2.0, 0.1, 0, 0], [0.1, 0.1, 0, 0]]))
    clipped = expert.unsaturated(torch.tensor([[0.65, 0.1, 0, 0]]))
    assert torch.equal(told[0], clipped[0]) and not torch.equal(told[1], clipped[0])


def test_a_model_without_a_probe_compares_its_commands_within_the_actuators_range():
    loop = replace(LOOP, scheduler="genie", controller=right_model(NOISY))
    seen, _ = watched(loop, "true_error", "state")
    command = NOISY.experts()["expert"](seen["state"][0])
    torch.testing.assert_close(seen["true_error"][0], (command / 40.0).abs()[:, 0].double(), atol=1e-4, rtol=1e-4)
    assert seen["true_error"].max() <= 1


def test_frames_cannot_be_compared():
    loop = replace(LOOP, controller=seeing(), radio=Radio(resource_blocks=2, codec="raw"))
    with pytest.raises(ValueError, match="choose a codec of embeddings"):
        run(replace(loop, scheduler="urgency"), 0)
    assert run(replace(loop, scheduler="expected_urgency", slots=3), 0).delivered.any()


def test_requests_are_counted_and_nobody_else_pays():
    names = ("urgency", "channel_aware", "first_contact")
    outcomes = [run(replace(LOOP, scheduler=name, slots=5), 0) for name in names]
    row = summary("urgency", [outcomes[0]] * 2, torch.ones(2, 6))
    assert row["signalling_bits_per_device_and_slot"] == 4.0
    assert outcomes[1].signalling_bits is None
    assert "signalling_bits_per_device_and_slot" not in summary("", [outcomes[1]] * 2, torch.ones(2, 6))
    unheard = outcomes[2].delivered.roll(1, 0).index_fill(0, torch.tensor([0]), False).cumsum(0) == 0
    assert torch.equal(outcomes[2].signalling_bits, 4 * unheard) and not unheard[-1].all()
    two = replace(LOOP.radio, requests=Requests(bits=2, delay=0))
    assert (run(replace(LOOP, scheduler="urgency", slots=5, radio=two), 0).signalling_bits == 2).all()
    changes = replace(LOOP.radio, requests=Requests(change=2))
    bits = run(replace(LOOP, scheduler="urgency", radio=changes), 0).signalling_bits
    assert set(bits.unique().tolist()) == {0, 4 + 3}


def test_a_function_of_the_users_own_is_told_the_urgency_where_requests_are_set():
    told = []

    def scheduler(known):
        told.append(known.urgency)
        return grant(known.age, known.candidate, known.demand, known.budget), known.memory

    run(replace(LOOP, scheduler=scheduler, slots=2), 0)
    run(replace(LOOP, scheduler=scheduler, slots=2, radio=replace(LOOP.radio, requests=Requests())), 0)
    assert [value is None for value in told] == [True] * 3 + [False] * 3


def test_a_scheduler_that_a_recipe_names_by_its_path_is_told_too():
    radio = replace(LOOP.radio, requests=Requests())
    by_path, by_name = (
        run(replace(LOOP, scheduler=name, radio=radio), 0) for name in ("tsjepa.radio.need.urgency", "urgency")
    )
    assert torch.equal(by_path.scheduled, by_name.scheduled) and by_name.scheduled.any()


@pytest.mark.parametrize("acknowledged", [True, False])
def test_a_device_runs_the_controller_in_step_whatever_becomes_of_its_commands(acknowledged):
    """The belief of a slot without a delivery is the prediction that the device had to know in front of it."""
    radio = replace(LOOP.radio, downlink=Downlink(loss=0.5, acknowledged=acknowledged))
    loop = replace(LOOP, scheduler="genie", controller="linear", radio=radio)
    keys = ("true_error", "state", "belief", "informed", "delivered", "action")
    seen, _ = watched(loop, *keys)
    wanted, told = (NOISY.experts()["expert"].unsaturated(seen[key]) / 40.0 for key in ("state", "belief"))
    silent = seen["informed"] & ~seen["delivered"] & ~torch.as_tensor(NOISY.failed(seen["state"]))
    error = (wanted - told).abs()[..., 0].double()
    torch.testing.assert_close(seen["true_error"][silent], error[silent], atol=1e-6, rtol=1e-5)
    assert silent.sum() > 20 and error[silent].max() > 0.01


def test_a_base_station_that_heard_of_no_delivery_keeps_the_request():
    seen, outcome = watched(
        replace(LOOP, scheduler="urgency", radio=replace(LOOP.radio, ack_loss=1.0)), "urgency", "true_error"
    )
    code = Requests().code()
    torch.testing.assert_close(seen["urgency"][1:], code.decode(code.encode(seen["true_error"][:-1])))
    assert (seen["urgency"][1:][outcome.delivered[:-1]] > 0).any()


def test_what_differs_between_devices_is_dealt_out_in_turn():
    radio = Radio(resource_blocks=None, snr_target_db=(0.0, 10.0), payload_bits=(500, 500, 4000), priority=(1.0, 2.0))
    known = []

    def scheduler(now):
        known.append(now)
        return now.candidate, now.memory

    env = make_env(NOISY, 6, scheduler, radio)
    mean = env.reset()["mean_snr"]
    torch.testing.assert_close(mean, torch.tensor([1.0, 10.0]).repeat(3))
    assert known[0].weight.tolist() == [1, 2, 1, 2, 1, 2]
    per_bit = known[0].demand / torch.tensor([500, 500, 4000]).repeat(2)
    rate = torch.log2(1 + known[0].snr.clamp(min=10**0.5)) * 180
    assert ((per_bit - 1 / rate).abs() <= 1 / 500).all()
    with pytest.raises(ValueError, match="priority"):
        Radio(priority=(1.0, 0.0))
    with pytest.raises(ValueError, match="snr_target_db"):
        Radio(snr_target_db=(0.0, 300.0))


def test_the_cost_of_age_is_each_plants_own():
    kinds = [CartPole(pole_length=length, process_noise_std=0.01) for length in (0.5, 1.5)]
    heard, unheard = cost_of_age(Mixed(kinds), 5)
    for device in range(5):
        plant = kinds[device % 2]
        value, noise = plant.error_cost()
        closed = age_cost_table(plant.linear()[0], value, noise, 20)
        torch.testing.assert_close(heard[device, :21], closed, rtol=0.15, atol=0)
        start = torch.tensor(plant.start_half_widths.copy())
        first = (value.diagonal() * start**2 / 3).sum()
        torch.testing.assert_close(unheard[device, 0], first, rtol=0.1, atol=0)
    # a shorter pole falls faster: its cost grows faster, and it is given up sooner
    assert heard[0, 20] / heard[0, 1] > 1.2 * heard[1, 20] / heard[1, 1]
    assert (unheard[0] > 0).sum() < (unheard[1] > 0).sum()
    with pytest.raises(ValueError, match="costs nothing"):
        cost_of_age(CartPole(), 2)
    for plant in (Reacher(), Pendulum()):
        with pytest.raises(ValueError, match="does not say what an error"):
            cost_of_age(plant, 2)


@pytest.mark.slow
def test_urgency_serves_a_crowd_that_age_cannot():
    crowd = Loop(
        OpenPlant(process_noise_std=0.008), "linear", num_devices=40, slots=250, radio=Radio(resource_blocks=2)
    )
    outcomes = {name: run(replace(crowd, scheduler=name), 0) for name in ("channel_aware", "urgency", "genie")}
    score = {name: outcome.raw_score().mean() for name, outcome in outcomes.items()}
    fallen = {name: outcome.failed().float().mean() for name, outcome in outcomes.items()}
    assert score["urgency"] > 1.2 * score["channel_aware"] and score["genie"] > score["urgency"] - 0.02
    assert fallen["urgency"] < fallen["channel_aware"] / 2


@pytest.mark.slow
@pytest.mark.parametrize("csi, blocks", [("perfect", 3), ("statistical", 5)])
def test_weights_by_the_plants_cost_beat_plain_age_in_a_mixed_fleet(csi, blocks):
    kinds = [CartPole(pole_length=length, process_noise_std=0.008) for length in (0.5, 1.0, 1.5)]
    radio = Radio(resource_blocks=blocks, snr_target_db=(0.0, 5.0, 10.0, 15.0, 20.0), csi=csi)
    fleet = Loop(Mixed(kinds), "linear", num_devices=30, slots=250, radio=radio)
    scores = {
        name: sum(run(replace(fleet, scheduler=name), seed).raw_score().mean().item() for seed in range(2))
        for name in ("channel_aware", "channel_aware_cost")
    }
    assert scores["channel_aware_cost"] > scores["channel_aware"]


@pytest.mark.slow
def test_a_fallen_device_takes_no_radio_from_the_others():
    """Poles on links too weak to be heard in time cost ever more, until they are given up: the rest is served."""
    plant = CartPole(pole_length=0.5, process_noise_std=0.008)
    radio = Radio(resource_blocks=3, snr_target_db=(-2.0, 15.0, 15.0, 15.0, 15.0), csi="statistical")
    fleet = Loop(plant, "linear", "channel_aware_cost", num_devices=20, slots=200, radio=radio)
    outcome = run(fleet, 0)
    weak = torch.arange(20) % 5 == 0
    assert outcome.failed()[weak].all() and not outcome.failed()[~weak].any()
    late = outcome.scheduled[100:].float().sum(0)
    assert late[weak].sum() < 0.05 * late.sum()
