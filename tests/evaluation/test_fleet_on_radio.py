"""The fleet on its radio, against loops whose outcome is known without one."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from tsjepa.envs.update_codec import fitted_codec
from tsjepa.evaluation.closed_loop import SemanticPolicy, run, true_state_policy
from tsjepa.evaluation.fleet import build_fleet, optimal_scores, run_fleet
from tsjepa.plants.expert import Expert

from tsjepa.envs import FleetEnv, Renderer
from tsjepa.envs.settings import Plants, Radio
from tsjepa.envs.transforms import Channel, Codec, Estimator, Scheduler, Uplink
from tsjepa.evaluation.metrics import normalized_score
from tsjepa.evaluation.simulate import device_rows, summary
from tsjepa.models import Architecture, SemanticController
from tsjepa.radio.codecs import AffineCodec, FloatCodec

PLANTS = Plants(slots=25)
PERFECT = Radio(resource_blocks=6, lossless=True)
STATE_BITS = 4 * 32


def fleet_run(count=6, scheduler="channel_aware", seed=0, plants=PLANTS, radio=PERFECT, controller="hold"):
    model = None if isinstance(controller, str) else controller
    return run_fleet(count, scheduler, seed, plants, radio, fitted_codec(radio.codec, model), controller)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    model = SemanticController(Architecture(widths=(8, 8, 8), embedding_dim=16, predictor_hidden_dim=8)).eval()
    model.code_low.fill_(-1)
    model.code_high.fill_(1)
    return model


@pytest.mark.parametrize("controller", ["hold", "linear"])
@pytest.mark.parametrize("scheduler", ["oracle", "round_robin", "max_age"])
def test_a_fleet_that_always_hears_is_the_closed_loop_with_perfect_feedback(controller, scheduler):
    radio = replace(PERFECT, resource_blocks=2, lossless=False) if scheduler == "oracle" else PERFECT
    loop = fleet_run(scheduler=scheduler, radio=radio, controller=controller).loop
    perfect = run(PLANTS.starts(0, 6), true_state_policy(Expert(), 1))
    assert torch.equal(loop.state, perfect.state)
    assert torch.equal(loop.action, perfect.action)
    assert torch.equal(loop.expert_action, perfect.expert_action)


def test_perfect_feedback_scores_one():
    plants = replace(PLANTS, slots=100)
    best, optimal = optimal_scores(plants, 1, 8)
    law_scores = fleet_run(8, "oracle", plants=plants).loop.raw_score()
    assert optimal.shape == (1, 8)
    if best == "expert":
        assert normalized_score(law_scores, optimal[0]) == 1.0
    assert normalized_score(law_scores, optimal[0]) == pytest.approx(1.0, abs=0.15)


def test_a_model_that_always_hears_is_the_closed_loop_with_an_update_in_every_slot(model):
    plants = replace(PLANTS, slots=4, frame_history=model.frame_history)
    fleet = fleet_run(3, "oracle", plants=plants, controller=model)
    loop = run(plants.starts(0, 3), SemanticPolicy(model, Renderer().render, 1))
    torch.testing.assert_close(fleet.loop.state, loop.state, atol=1e-5, rtol=1e-5)
    assert (fleet.payload_bits == 16 * 32).all()


def test_sending_raw_frames_or_their_embedding_is_the_same_control(model):
    plants, radio = replace(PLANTS, slots=6), Radio(resource_blocks=1, snr_target_db=8.0)
    embeddings = fleet_run(3, "round_robin", plants=plants, radio=radio, controller=model)
    frames = fleet_run(3, "round_robin", plants=plants, radio=replace(radio, codec="raw"), controller=model)
    torch.testing.assert_close(frames.loop.action, embeddings.loop.action, atol=1e-4, rtol=1e-4)
    assert (frames.payload_bits[frames.scheduled] == 2 * 64 * 128 * 3 * 8).all()


def test_integer_codecs_cover_the_state_space_or_what_the_model_was_fitted_on(model):
    state = fitted_codec("int8", None)
    values = torch.tensor([[0.8, 0.3, -0.3, 0.3]])
    torch.testing.assert_close(state.decode(state.encode(values)), values, atol=0.02, rtol=0)
    embedding = fitted_codec("int4", model)
    assert isinstance(embedding.codec, AffineCodec)
    assert torch.equal(embedding.codec.low, model.code_low)
    assert embedding.decode(embedding.encode(torch.randn(2, 16))).norm(dim=-1).tolist() == pytest.approx([1, 1])


def test_schedulers_meet_the_same_plants_and_channels():
    radio, seen = Radio(resource_blocks=2), {}
    for scheduler in ("channel_aware", "random"):
        env, _ = build_fleet(6, scheduler, 3, PLANTS, radio, FloatCodec(), "linear")
        data = env.rollout(8, policy=lambda tensordict: tensordict.set("action", torch.full((6, 1), 2.0)))
        seen[scheduler] = data.select("state", "snr", "los", "path_loss_db", "scheduled")
    for key in ("state", "snr", "los", "path_loss_db"):
        assert torch.equal(seen["channel_aware"][key], seen["random"][key])
    assert not torch.equal(seen["channel_aware"]["scheduled"], seen["random"]["scheduled"])


def test_a_device_is_the_same_plant_in_a_larger_fleet():
    small, large = fleet_run(2, "oracle"), fleet_run(5, "oracle")
    assert torch.equal(small.loop.state, large.loop.state[:, :2])


def test_linear_prediction_beats_a_held_command_at_five_devices_per_block():
    plants, radio = replace(PLANTS, slots=100), Radio(resource_blocks=3)
    scores = {
        controller: fleet_run(15, "round_robin", 0, plants, radio, controller).loop.raw_score().mean()
        for controller in ("hold", "linear")
    }
    assert scores["linear"] > 2 * scores["hold"]


def test_nobody_acts_on_a_device_that_was_never_heard():
    for controller in ("hold", "linear"):
        silent = fleet_run(scheduler="none", controller=controller)
        assert (silent.loop.action == 0).all()
        assert torch.equal(silent.age[-1], torch.full((6,), PLANTS.slots + 1))


def test_the_row_counts_what_was_sent_and_what_arrived():
    radio = Radio(resource_blocks=2)
    runs = [fleet_run(scheduler="round_robin", seed=seed, radio=radio) for seed in range(2)]
    row = summary("round_robin", runs, torch.ones(2, 6))
    assert row["utilisation"] == 1.0
    assert row["bits_per_device_and_slot"] == pytest.approx(STATE_BITS * 2 / 6)
    assert sum(row["age_counts"]) == 2 * 6 * PLANTS.slots
    ages = sum((index + 1) * count for index, count in enumerate(row["age_counts"]))
    assert row["mean_age"] == pytest.approx(ages / sum(row["age_counts"]))
    devices = device_rows("round_robin", runs, torch.ones(2, 6))
    assert len(devices) == 12
    sent, arrived = (sum(device[key] for device in devices) for key in ("transmissions", "deliveries"))
    assert sent == 2 * 2 * PLANTS.slots
    assert row["delivery_rate"] == pytest.approx(arrived / sent)
    assert 0.5 < row["delivery_rate"] < 0.95  # 73 % at 10 dB over a threshold of 5 dB


def test_units_are_shared_by_payload():
    radio = Radio(resource_blocks=None, snr_target_db=10.0)
    result = fleet_run(scheduler="channel_aware", radio=radio)
    assert result.capacity == 2120
    # 128 bits fit into one unit of 623 bits at 10 dB and, at the threshold of 5 dB, of 370
    assert torch.equal(result.used, result.scheduled.sum(-1))
    with pytest.raises(ValueError, match=r"radio\.payload_bits"):
        fleet_run(radio=replace(radio, codec="webp"), controller=SemanticController(Architecture()))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"scheduler": "fifo"}, "fifo"),
        ({"controller": "pid"}, "pid"),
        ({"radio": replace(PERFECT, codec="png")}, "png"),
    ],
)
def test_what_does_not_exist_is_named(options, named):
    with pytest.raises(ValueError, match=named):
        fleet_run(**options)


def test_resetting_devices_leaves_the_others_bit_identical():
    """Same commands, J = I so that the schedule does not couple the devices; every key, plant, radio and belief."""
    from torchrl.envs import Compose, TransformedEnv
    from torchrl.envs.utils import step_mdp

    generator = torch.Generator().manual_seed(0)
    commands = 5 * torch.randn(12, 6, 1, generator=generator)

    def rollout(resets: dict[int, torch.Tensor]) -> TensorDict:
        env = TransformedEnv(
            FleetEnv(6, process_noise_std=0.01, frame_history=3, random_colors=True, seed=1),
            Compose(
                Channel(snr_target_db=8.0, max_doppler_hz=10.0, seed=1),
                Scheduler("max_age", resource_blocks=6),
                Codec(FloatCodec(), in_key="state"),
                Uplink(),
                Estimator(lambda state, force: 0.9 * state + 0.01 * force),
            ),
        )
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
