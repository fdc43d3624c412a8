from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from torch.nn import functional as F

from tsjepa.models import Predictor, StateProbe
from tsjepa.training.actor import imitation_pairs
from tsjepa.training.finish.probe import fit_probe
from tsjepa.training.finish.refine import RefinePredictor, refine_predictor
from tsjepa.training.monitor import prediction_skill

D = 16


@pytest.fixture
def embedded():
    """Trajectories whose embedding turns with the command: [4, 30]."""
    generator = torch.Generator().manual_seed(0)
    action = 10 * torch.randn(4, 30, 1, generator=generator)
    phase = torch.rand(D // 2, generator=generator) * 6
    speed = 0.05 + 0.1 * torch.rand(D // 2, generator=generator)
    angle = (0.2 * action).cumsum(1) * speed + phase
    embedding = F.normalize(torch.cat((angle.cos(), angle.sin()), dim=-1), dim=-1)
    state = torch.randn(4, 30, 4, generator=generator)
    return TensorDict(
        {"embedding": embedding, "action": action.roll(-1, 1), "expert_action": -action, "state": state}, [4, 30]
    )


def test_refining_lowers_the_prediction_error_and_repeats_itself(embedded):
    torch.manual_seed(0)
    first, second = Predictor(D, 64), Predictor(D, 64)
    second.load_state_dict(first.state_dict())
    for predictor in (first, second):
        predictor.command_std.fill_(10.0)
    before = prediction_skill(first, embedded["embedding"], embedded["action"], (5,))[5]
    for predictor in (first, second):
        refine_predictor(predictor, embedded, steps=60, horizon=5, batch_size=32, learning_rate=3e-3, seed=1)
    with torch.no_grad():
        after = prediction_skill(first, embedded["embedding"], embedded["action"], (5,))[5]
    assert after > before + 0.1
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True))


def test_rollouts_can_all_begin_at_the_starts(embedded):
    predictor = Predictor(D, 8)
    embedded["embedding"][:, 6:] = float("nan")  # beyond what a roll-out of 5 slots from the start reaches
    refine_predictor(
        predictor, embedded, steps=3, horizon=5, batch_size=16, learning_rate=1e-3, seed=0, start_share=1.0
    )
    assert all(parameter.isfinite().all() for parameter in predictor.parameters())


def test_a_share_of_the_rollouts_is_taken_from_the_starts(embedded):
    def refined(share, starts):
        torch.manual_seed(0)
        predictor = Predictor(D, 8)
        sizes = {"steps": 3, "horizon": 5, "batch_size": 16, "learning_rate": 1e-3, "seed": 0}
        refine_predictor(predictor, embedded, **sizes, start_share=share, starts=starts)
        return all(bool(parameter.isfinite().all()) for parameter in predictor.parameters())

    unusable = embedded[:, :10].clone()
    unusable["embedding"] *= float("nan")
    assert refined(0.0, unusable)
    assert not refined(0.25, unusable)
    assert refined(0.25, embedded[:, :10])


def test_refining_over_more_slots_than_there_are_is_refused(embedded):
    with pytest.raises(ValueError, match="30 slots does not fit into trajectories of 30"):
        refine_predictor(Predictor(D, 8), embedded, steps=1, horizon=30, batch_size=1, learning_rate=1e-3, seed=0)


def test_a_horizon_that_does_not_fit_is_refused_before_the_fit():
    def begins(horizon, starts):
        slots = {"train": 31, "starts": 14}
        data = SimpleNamespace(splits=("train",), first_slot=1, split=lambda name: torch.empty(4, slots[name]))
        RefinePredictor(horizon=horizon, starts=starts).on_fit_start(SimpleNamespace(datamodule=data), None)

    begins(29, None)
    begins(12, "starts")
    with pytest.raises(ValueError, match="30 slots does not fit into trajectories of 30"):
        begins(30, None)
    with pytest.raises(ValueError, match="13 slots does not fit into trajectories of 13"):
        begins(13, "starts")


def test_imitation_pairs_are_those_of_a_naive_double_loop(embedded):
    torch.manual_seed(0)
    model = SimpleNamespace(predictor=Predictor(D, 32))
    horizons = (0, 2, 2, 5)
    pairs = imitation_pairs(model, embedded, horizons)
    expected = []
    with torch.no_grad():
        for ahead in sorted(horizons):
            for episode in range(4):
                for start in range(30 - ahead):
                    belief = embedded["embedding"][episode, start]
                    for slot in range(start, start + ahead):
                        belief = model.predictor(belief, embedded["action"][episode, slot])
                    row = embedded[episode, start + ahead]
                    expected.append(torch.cat((belief, row["expert_action"], row["state"])))
    made = torch.cat((pairs["embedding"], pairs["expert_action"], pairs["state"]), dim=1)
    torch.testing.assert_close(made, torch.stack(expected))


def test_imitation_pairs_refuse_a_horizon_as_long_as_the_trajectories(embedded):
    with pytest.raises(ValueError, match="30 slots does not fit"):
        imitation_pairs(SimpleNamespace(predictor=Predictor(D, 32)), embedded, (30,))


def test_the_probe_learns_a_state_that_the_embedding_holds():
    generator = torch.Generator().manual_seed(0)
    embedding = F.normalize(torch.randn(400, D, generator=generator), dim=-1)
    state = embedding @ torch.randn(D, 4, generator=generator) * torch.tensor([1.0, 0.1, 5.0, 2.0]) + 3
    torch.manual_seed(0)
    probe = StateProbe(4, D, 64)
    fit_probe(probe, embedding, state, steps=200, batch_size=128)
    torch.testing.assert_close(probe.state_mean, state.mean(0))
    with torch.no_grad():
        error = (probe(embedding) - state).square().mean(0).sqrt() / state.std(0)
    assert (error < 0.3).all()
