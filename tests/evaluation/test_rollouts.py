"""The loop with models that are right by construction, against the expert on the true state and known radios."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from open_plant import OpenPlant, right_model, states_of

from tsjepa.envs import Radio
from tsjepa.envs.make import at_weights
from tsjepa.evaluation.fleet_summary import device_rows, summary
from tsjepa.evaluation.metrics import normalized_score
from tsjepa.evaluation.rollouts import ONCE, Loop, every, optimal_scores, perfect_feedback, run
from tsjepa.plants import CartPole
from tsjepa.support.seeds import HELD_OUT

PLANT = OpenPlant()
LOOP = Loop(PLANT, right_model(PLANT), num_devices=4, slots=30, frame_history=3)
FLEET = Loop(PLANT, num_devices=6, slots=25, radio=Radio(resource_blocks=6, lossless=True))
STATE_BITS = 4 * 32


def held(period: int, controller: str = "hold", loop: Loop = LOOP):
    return run(every(replace(loop, controller=controller), period), 0)


def by_hand(plant: CartPole, count: int, slots: int, history: int, seed: int):
    """States [slots + 1, count, 4] under the expert, from the plant's methods alone."""
    device, episode = np.arange(count), np.zeros(count, np.int64)
    physics = plant.start(HELD_OUT + seed, device, episode)
    states, expert = [], plant.experts()["expert"]
    for slot in range(1 - history, slots):
        if slot >= 0:
            states.append(torch.from_numpy(physics).float())
        command = expert(states[-1]).double().numpy() if slot >= 0 else np.zeros((count, 1))
        physics = plant.advance(physics, command, HELD_OUT + seed, device, episode, np.full(count, slot))
    return torch.stack([*states, torch.from_numpy(physics).float()])


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_perfect_feedback_is_the_expert_applied_by_hand(noise):
    plant = OpenPlant(process_noise_std=noise)
    outcome = run(perfect_feedback(replace(LOOP, plant=plant), "expert"), 7)
    assert outcome.state.shape == (31, 4, 4)
    assert outcome.action.shape == outcome.expert_action.shape == (30, 4, 1)
    assert torch.equal(outcome.state, by_hand(plant, 4, 30, 3, 7))
    assert torch.equal(outcome.action, outcome.expert_action)
    assert torch.equal(outcome.score, plant.score(outcome.state[1:]).float())
    assert torch.equal(outcome.cost, plant.cost(outcome.state[1:], outcome.action))


@pytest.mark.parametrize("period", [1, 5, ONCE])
def test_a_model_that_is_right_does_what_the_expert_does_however_rare_the_updates(period):
    outcome, expected = run(every(LOOP, period), 0), run(perfect_feedback(LOOP, "expert"), 0)
    torch.testing.assert_close(outcome.state, expected.state, atol=2e-4, rtol=0)
    torch.testing.assert_close(outcome.action, expected.action, atol=2e-2, rtol=0)


@pytest.mark.parametrize(("period", "updates"), [(1, 30), (2, 15), (7, 5), (30, 1), (ONCE, 1)])
def test_frames_are_encoded_and_sent_at_updates_only(period, updates):
    model = right_model(PLANT)
    outcome = run(every(replace(LOOP, controller=model), period), 0)
    assert len(model.encoder.given) - updates in (0, 1)  # the last slot's state is looked at once more, and unused
    assert int(outcome.scheduled.sum()) == 4 * updates
    assert int(outcome.payload_bits.sum()) == 4 * updates * 5 * 32


@pytest.mark.parametrize(("spacing", "history"), [(1, 2), (2, 3), (1, 4), (2, 4)])
def test_a_stack_holds_the_frames_of_now_and_of_frame_spacing_slots_ago(spacing, history):
    model, seen = right_model(PLANT, spacing), []
    loop = replace(LOOP, controller=model, slots=4, frame_history=history)
    outcome = run(every(loop, 1), 0, lambda slot, now: seen.append(now["scene"]))
    stack = states_of(model.encoder.given[3])
    assert torch.equal(stack[:, 1], outcome.state[3])
    assert torch.equal(stack[:, 0], outcome.state[3 - spacing])
    # in the first slot the older frame is from before step 0
    assert torch.equal(states_of(model.encoder.given[0])[:, 0], seen[0][:, -1 - spacing])


def test_before_step_0_the_plant_ran_at_rest():
    device = np.arange(4)
    physics = PLANT.start(HELD_OUT, device, 0 * device)
    for _ in range(2):
        physics = PLANT.stepper.advance(physics, np.zeros((4, 1)))
    torch.testing.assert_close(held(1).state[0], torch.from_numpy(physics).float(), rtol=0, atol=0)


def test_starts_are_those_of_the_seed_within_the_plants_limits():
    first, again, other = (
        run(every(replace(LOOP, controller="hold", num_devices=50, slots=1, frame_history=1), 1), seed).state[0]
        for seed in (1, 1, 2)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert (first.abs() <= torch.tensor([0.8, 0.3, 0.3, 0.3])).all()
    assert (first[:, 0].abs().max() > 0.6) and (first[:, 1].abs().max() > 0.22)


def test_between_updates_the_last_command_is_held_or_there_is_none():
    expert = PLANT.experts()["expert"]
    hold, zero = held(5), held(5, "zero")
    for slot in range(30):
        last = slot - slot % 5
        assert torch.equal(hold.action[slot], expert(hold.state[last]))
        assert torch.equal(zero.action[slot], expert(zero.state[slot]) if slot == last else torch.zeros(4, 1))


def test_a_model_without_predictor_holds_its_command_between_updates():
    model = right_model(PLANT, predicts=False)
    outcome = run(every(replace(LOOP, controller=model, blend=0.5), 5), 0)
    torch.testing.assert_close(outcome.state, held(5).state, atol=1e-4, rtol=0)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_plan_sent_once_is_perfect_feedback_while_nothing_disturbs_the_plant(noise):
    loop = replace(LOOP, plant=OpenPlant(process_noise_std=noise))
    feedback, planned = run(perfect_feedback(loop, "expert"), 0), held(ONCE, "exact", loop)
    assert torch.equal(planned.action[0], feedback.action[0])
    assert torch.allclose(planned.state, feedback.state, atol=1e-3) == (noise == 0)


def test_a_blend_mixes_received_with_predicted_and_brings_them_to_unit_length():
    beliefs, received = [], []

    def watch(slot, now):
        beliefs.append(now["belief"])
        received.append(now["received"])

    loop = replace(LOOP, controller=right_model(PLANT), blend=0.25, slots=2)
    outcome = run(every(loop, 1), 0, watch)
    predicted = LOOP.controller.predict(beliefs[0], outcome.action[0])
    mixed = torch.nn.functional.normalize(0.75 * predicted + 0.25 * received[1], dim=-1)
    assert torch.equal(beliefs[0], received[0])
    torch.testing.assert_close(beliefs[1], mixed)


@pytest.mark.parametrize("controller", ["hold", "linear"])
@pytest.mark.parametrize("scheduler", ["oracle", "round_robin", "max_age"])
def test_a_fleet_that_always_hears_is_the_loop_with_perfect_feedback(controller, scheduler):
    radio = Radio(resource_blocks=2) if scheduler == "oracle" else FLEET.radio
    outcome = run(replace(FLEET, scheduler=scheduler, radio=radio, controller=controller), 0)
    perfect = run(perfect_feedback(FLEET, "expert"), 0)
    for name in ("state", "action", "expert_action"):
        assert torch.equal(getattr(outcome, name), getattr(perfect, name))


def test_the_normaliser_scores_one_on_every_smaller_fleet_too():
    loop = replace(FLEET, slots=100)
    optimal = optimal_scores(loop, 2)
    assert optimal.shape == (2, 6)
    told = replace(perfect_feedback(loop, PLANT.normaliser), num_devices=4)
    assert normalized_score(run(told, 1).raw_score(), optimal[1, :4]) == 1.0


def test_an_expert_that_there_is_not_is_named():
    with pytest.raises(ValueError, match=r"OpenPlant has no expert 'nobody'; there are .*set the plant's attribute"):
        perfect_feedback(FLEET, "nobody").policy()


def test_sending_raw_frames_or_their_embedding_is_the_same_control():
    loop = replace(FLEET, num_devices=3, controller=right_model(PLANT), scheduler="round_robin")
    embeddings = run(replace(loop, radio=Radio(resource_blocks=1, snr_target_db=8.0)), 0)
    frames = run(replace(loop, radio=Radio(resource_blocks=1, snr_target_db=8.0, codec="raw")), 0)
    torch.testing.assert_close(frames.action, embeddings.action, atol=1e-2, rtol=0)
    assert (frames.payload_bits[frames.scheduled] == 2 * 2 * 4 * 3 * 8).all()


def test_schedulers_meet_the_same_plants_and_channels():
    seen = {}
    for scheduler in ("channel_aware", "random"):
        env = replace(FLEET, scheduler=scheduler, radio=Radio(resource_blocks=2), controller="linear").env(3)
        data = env.rollout(8, policy=lambda tensordict: tensordict.set("action", torch.full((6, 1), 2.0)))
        seen[scheduler] = data.select("state", "snr", "los", "path_loss_db", "scheduled")
    for key in ("state", "snr", "los", "path_loss_db"):
        assert torch.equal(seen["channel_aware"][key], seen["random"][key])
    assert not torch.equal(seen["channel_aware"]["scheduled"], seen["random"]["scheduled"])


def test_a_device_is_the_same_plant_in_a_larger_fleet():
    small, large = (run(perfect_feedback(replace(FLEET, num_devices=count), "expert"), 0) for count in (2, 5))
    assert torch.equal(small.state, large.state[:, :2])


def test_linear_prediction_beats_a_held_command_at_five_devices_per_block():
    crowded = replace(FLEET, num_devices=15, slots=100, scheduler="round_robin", radio=Radio(resource_blocks=3))
    hold, linear = (run(replace(crowded, controller=name), 0).raw_score().mean() for name in ("hold", "linear"))
    assert linear > 2 * hold


@pytest.mark.parametrize("controller", ["hold", "linear"])
def test_nobody_acts_on_a_device_that_was_never_heard(controller):
    silent = run(replace(FLEET, scheduler="none", controller=controller), 0)
    assert (silent.action == 0).all()
    assert torch.equal(silent.age[-1], torch.full((6,), FLEET.slots + 1))


def test_the_rows_of_a_fleet_count_what_was_sent_and_what_arrived():
    loop = replace(FLEET, scheduler="round_robin", radio=Radio(resource_blocks=2))
    runs = [run(loop, seed) for seed in range(2)]
    row = summary("round_robin", runs, torch.ones(2, 6))
    assert row["utilisation"] == 1.0
    assert row["bits_per_device_and_slot"] == pytest.approx(STATE_BITS * 2 / 6)
    assert sum(row["age_counts"]) == 2 * 6 * FLEET.slots
    ages = sum((index + 1) * count for index, count in enumerate(row["age_counts"]))
    assert row["mean_age"] == pytest.approx(ages / sum(row["age_counts"]))
    devices = device_rows("round_robin", runs, torch.ones(2, 6))
    assert len(devices) == 12
    sent, arrived = (sum(device[key] for device in devices) for key in ("transmissions", "deliveries"))
    assert sent == 2 * 2 * FLEET.slots
    assert row["delivery_rate"] == pytest.approx(arrived / sent)
    assert 0.5 < row["delivery_rate"] < 0.95  # 73 % at 10 dB over a threshold of 5 dB


def test_units_are_shared_by_payload():
    in_units = Radio(resource_blocks=None, snr_target_db=10.0)
    outcome = run(replace(FLEET, radio=in_units), 0)
    assert outcome.capacity == 2120
    # 128 bits fit into one unit of 623 bits at 10 dB and, at the threshold of 5 dB, of 370
    assert torch.equal(outcome.used, outcome.scheduled.sum(-1))
    with pytest.raises(ValueError, match=r"radio\.payload_bits"):
        run(replace(LOOP, radio=replace(in_units, codec="webp")), 0)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"scheduler": "fifo"}, "fifo"),
        ({"controller": "pid"}, "pid"),
        ({"radio": Radio(codec="png")}, "png"),
        ({"controller": right_model(OpenPlant(sampling_interval=0.01))}, "slot in seconds of 0.01"),
    ],
)
def test_what_does_not_exist_or_fit_is_named(changes, named):
    with pytest.raises(ValueError, match=named):
        run(replace(FLEET, **changes), 0)


def test_a_models_parts_compute_where_its_weights_lie_and_give_back_what_they_make():
    model, devices = torch.nn.Linear(1, 1, device="meta"), []

    def method(embedding, reference):
        devices.append((embedding.device.type, reference))
        return torch.ones(2)

    made = at_weights(model, method)(torch.zeros(2), None)
    assert devices == [("meta", None)]
    assert made.device.type == "cpu"


def test_a_plant_whose_state_is_not_its_physics_is_not_predicted_exactly():
    class Hidden(OpenPlant):
        def state(self, physics):
            return physics + 1

    with pytest.raises(ValueError, match="cannot be predicted exactly"):
        run(replace(LOOP, plant=Hidden(), controller="exact"), 0)


def test_resetting_devices_leaves_the_others_bit_identical():
    """Same commands, J = I so that the schedule does not couple the devices; every key, plant, radio and belief."""
    from torchrl.envs.utils import step_mdp

    generator = torch.Generator().manual_seed(0)
    commands = 5 * torch.randn(12, 6, 1, generator=generator)
    radio = Radio(resource_blocks=6, snr_target_db=8.0, max_doppler_hz=10.0)
    loop = replace(FLEET, plant=OpenPlant(process_noise_std=0.01), radio=radio, controller="linear", frame_history=3)

    def rollout(resets: dict[int, torch.Tensor]):
        env = replace(loop, scheduler="max_age").env(1)
        now, slots = env.reset(), []
        for slot, command in enumerate(commands):
            if slot in resets:
                now = env.reset(now.set("_reset", resets[slot].unsqueeze(-1)))
            now = env.step(now.set("action", command))
            slots.append(now.exclude("_reset"))
            now = step_mdp(now)
        return torch.stack(slots)

    quiet = rollout({})
    for _ in range(3):
        chosen = torch.rand(6, generator=generator) < 0.5
        noisy = rollout({3: chosen, 7: chosen})
        for key in quiet.keys(include_nested=True, leaves_only=True):
            # the scheduler's memory is its own, not a device's
            if "scheduler_memory" not in key:
                assert torch.equal(noisy[key][:, ~chosen], quiet[key][:, ~chosen]), key
        assert not torch.equal(noisy["state"][:, chosen], quiet["state"][:, chosen])
