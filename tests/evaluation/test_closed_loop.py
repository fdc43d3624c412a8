"""The loop with models that are right by construction, against the expert on the true state."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from tsjepa.evaluation.closed_loop import (
    ONCE,
    SemanticPolicy,
    Starts,
    is_update,
    planned_policy,
    run,
    true_state_policy,
)
from tsjepa.plants.dynamics import Dynamics
from tsjepa.plants.expert import Expert

INTERVAL = 0.02
STARTS = Starts(seed=0, count=4, slots=30, frame_history=3)


class Oracle:
    """A model whose embedding is the plant's state, read from frames that hold qpos, and whose prediction is the plant.

    Velocity is the exact one of the plant, looked up by qpos, so that nothing is lost on the way.
    """

    def __init__(self, frame_spacing: int = 2, has_predictor: bool = True) -> None:
        self.architecture = SimpleNamespace(frame_spacing=frame_spacing, has_predictor=has_predictor)
        self.frame_history = frame_spacing + 1
        self.expert, self.dynamics = Expert(INTERVAL), Dynamics(INTERVAL)
        self.states: dict[tuple, torch.Tensor] = {}
        self.encoded, self.frames = 0, None

    def remember(self, observation) -> None:
        for qpos, state in zip(observation["qpos"][:, -1], observation["state"], strict=True):
            self.states[tuple(qpos.tolist())] = state

    def render(self, qpos: np.ndarray, colors: np.ndarray) -> np.ndarray:
        assert colors.shape == (len(qpos), 2, 3)
        return qpos.astype(np.float32)

    def encode(self, frames: torch.Tensor) -> torch.Tensor:
        self.encoded, self.frames = self.encoded + 1, frames
        return torch.stack([self.states[tuple(newest.tolist())] for newest in frames[:, -1]])

    def predict(self, belief: torch.Tensor, command: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(self.dynamics.advance(belief.double().numpy(), command[:, 0].double().numpy())).float()

    def act(self, belief: torch.Tensor) -> torch.Tensor:
        return self.expert(belief)


def drive(model: Oracle, period: int, starts: Starts = STARTS, **options):
    """The oracle's loop, and the observations it saw."""
    policy, seen = SemanticPolicy(model, model.render, period, **options), []

    def watched(slot, observation):
        model.remember(observation)
        seen.append(observation.clone())
        return policy(slot, observation)

    return run(starts, watched), seen


def test_the_expert_with_an_update_every_slot_errs_by_nothing():
    loop = run(STARTS, true_state_policy(Expert(INTERVAL), 1))
    assert loop.state.shape == (31, 4, 4)
    assert loop.action.shape == loop.expert_action.shape == (30, 4, 1)
    assert torch.equal(loop.action, loop.expert_action)
    assert not loop.failed().any()
    assert torch.equal(loop.state, run(STARTS, true_state_policy(Expert(INTERVAL), 1)).state)


@pytest.mark.parametrize("period", [1, 5, ONCE])
def test_a_model_that_is_right_does_what_the_expert_does_however_rare_the_updates(period):
    expected = run(STARTS, true_state_policy(Expert(INTERVAL), 1))
    loop, _ = drive(Oracle(), period)
    torch.testing.assert_close(loop.state, expected.state, atol=2e-4, rtol=0)
    torch.testing.assert_close(loop.action, expected.action, atol=2e-2, rtol=0)


@pytest.mark.parametrize(("period", "updates"), [(1, 30), (2, 15), (7, 5), (30, 1), (ONCE, 1)])
def test_frames_are_encoded_at_updates_only(period, updates):
    model = Oracle()
    drive(model, period)
    assert model.encoded == updates == sum(is_update(slot, period) for slot in range(30))


@pytest.mark.parametrize(("spacing", "history"), [(1, 2), (2, 3), (1, 4), (2, 4)])
def test_a_stack_holds_the_frames_of_now_and_of_frame_spacing_slots_ago(spacing, history):
    model = Oracle(spacing)
    _, seen = drive(model, 1, Starts(seed=0, count=2, slots=4, frame_history=history))
    newest, oldest = seen[3]["qpos"][:, -1], seen[3 - spacing]["qpos"][:, -1]
    assert torch.equal(model.frames, torch.stack((oldest, newest), dim=1))


def test_before_step_0_the_plant_ran_under_zero_force():
    observation = STARTS.fleet().reset()
    history = observation["qpos"]
    assert torch.equal(history[:, -1], observation["state"][:, :2])
    # velocities are within 0.3 at the drawn start, so two slots of 20 ms move the cart by at most about 12 mm
    moved = (history[:, -1] - history[:, 0]).abs()
    assert (moved[:, 0] < 0.3 * 2 * INTERVAL + 2e-3).all()
    assert (moved > 0).all()
    drawn = Starts(seed=0, count=4, slots=30, frame_history=1).fleet().reset()["physics_state"].numpy()
    free = Dynamics(INTERVAL)
    later = free.advance(free.advance(drawn, np.zeros(4)), np.zeros(4))
    torch.testing.assert_close(observation["state"], torch.from_numpy(later).float())


def test_starts_are_those_of_the_seed_within_the_evaluations_limits():
    first, again, other = (Starts(seed, 50, frame_history=1).fleet().reset()["state"] for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert (first.abs() <= torch.tensor([0.8, 0.3, 0.3, 0.3])).all()
    assert (first[:, 0].abs().max() > 0.6) and (first[:, 1].abs().max() > 0.22)


def test_between_updates_the_last_command_is_held_or_there_is_none():
    expert = Expert(INTERVAL)
    held = run(STARTS, true_state_policy(expert, 5, "hold"))
    none = run(STARTS, true_state_policy(expert, 5, "zero"))
    for slot in range(30):
        last = slot - slot % 5
        assert torch.equal(held.action[slot], expert(held.state[last]))
        assert torch.equal(none.action[slot], expert(none.state[slot]) if slot == last else torch.zeros(4, 1))


def test_a_model_without_predictor_holds_its_command_between_updates():
    held = run(STARTS, true_state_policy(Expert(INTERVAL), 5, "hold"))
    model = Oracle(has_predictor=False)
    loop, _ = drive(model, 5, blend=0.5)
    assert model.encoded == 6
    assert torch.equal(loop.action, held.action)
    assert torch.equal(loop.state, held.state)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_plan_sent_once_is_perfect_feedback_while_nothing_disturbs_the_plant(noise):
    starts = Starts(seed=0, count=4, slots=30, process_noise_std=noise)
    feedback = run(starts, true_state_policy(Expert(INTERVAL), 1))
    planned = run(starts, planned_policy(Expert(INTERVAL), INTERVAL, 30))
    assert torch.equal(planned.action[0], feedback.action[0])
    assert torch.allclose(planned.state, feedback.state, atol=1e-3) == (noise == 0)


def test_a_codec_changes_what_is_acted_on_and_a_blend_mixes_received_with_predicted():
    silent, _ = drive(Oracle(), 1, codec=torch.zeros_like)
    assert (silent.action == 0).all()

    class Still(Oracle):
        def predict(self, belief, command):
            return torch.nn.functional.normalize(belief, dim=-1)

    model = Still()
    policy = SemanticPolicy(model, model.render, 1, blend=0.25)
    fleet = STARTS.fleet()
    observation = fleet.reset()
    model.remember(observation)
    command = policy(0, observation)
    first = policy.belief
    observation = fleet.step(observation.set("action", command))["next"]
    model.remember(observation)
    policy(1, observation)
    expected = 0.75 * torch.nn.functional.normalize(first, dim=-1) + 0.25 * observation["state"]
    torch.testing.assert_close(policy.belief, torch.nn.functional.normalize(expected, dim=-1))
