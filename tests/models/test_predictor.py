import pytest
import torch
from torch.nn import functional as F

from tsjepa.models import Actor, Predictor, StateProbe, rollout


def unit(*shape: int) -> torch.Tensor:
    return F.normalize(torch.randn(*shape, generator=torch.Generator().manual_seed(1)), dim=-1)


def test_rollout_is_the_predictor_applied_to_its_own_output():
    predictor = Predictor(8, 16)
    start, commands = unit(5, 8), torch.randn(5, 3, 1)
    expected, embedding = [], start
    for slot in range(3):
        embedding = predictor(embedding, commands[:, slot])
        expected.append(embedding)
    torch.testing.assert_close(rollout(predictor, start, commands), torch.stack(expected, 1))


def test_predictions_have_unit_length():
    torch.testing.assert_close(Predictor(8, 16)(unit(5, 8), torch.zeros(5, 1)).norm(dim=-1), torch.ones(5))


def test_commands_are_z_scored_with_the_saved_statistics():
    plain, scaled = Predictor(8, 16), Predictor(8, 16)
    scaled.load_state_dict(plain.state_dict())
    scaled.command_mean.fill_(3.0)
    scaled.command_std.fill_(2.0)
    command = torch.randn(5, 1)
    torch.testing.assert_close(scaled(unit(5, 8), 2 * command + 3), plain(unit(5, 8), command))


def test_a_residual_predictor_of_zeros_copies():
    predictor = Predictor(8, 16)
    torch.nn.init.zeros_(predictor.output.weight)
    torch.nn.init.zeros_(predictor.output.bias)
    torch.testing.assert_close(predictor(unit(5, 8), torch.ones(5, 1)), unit(5, 8))


def test_the_actor_respects_the_actuator_and_its_gradient_does_not():
    actor = Actor((-20.0,), (20.0,), 8, (16, 16), dropout=0.0)
    with torch.no_grad():
        actor.layers[-1].bias.fill_(5.0)
    embedding = unit(5, 8)
    assert (actor(embedding) == 20.0).all()
    assert (actor.unclipped(embedding) > 20.0).all()


def test_each_command_has_its_own_range():
    actor = Actor((-1.0, 0.0), (1.0, 10.0), 8, (16, 16), dropout=0.0)
    with torch.no_grad():
        actor.layers[-1].weight.zero_()
        for bias, expected in ((0.0, (0.0, 5.0)), (0.5, (0.5, 7.5)), (9.0, (1.0, 10.0)), (-9.0, (-1.0, 0.0))):
            actor.layers[-1].bias.fill_(bias)
            torch.testing.assert_close(actor(unit(5, 8)), torch.tensor([expected] * 5))


def test_the_actor_is_given_set_points_where_it_was_made_with_their_range():
    actor = Actor((-1.0,), (1.0,), 8, (16, 16), 0.0, reference_low=(-2.0, 0.0), reference_high=(2.0, 1.0))
    embedding, wanted = unit(5, 8), torch.tensor([1.0, 0.5])
    with torch.no_grad():
        assert actor(embedding, wanted).shape == (5, 1)
        assert not torch.equal(actor(embedding, wanted), actor(embedding, -wanted))
        # the middle of the range and its ends are 0, -1 and 1 to the network
        inputs = torch.cat((embedding * 8**0.5, torch.tensor([[0.5, 0.0]]).expand(5, 2)), dim=-1)
        torch.testing.assert_close(actor(embedding, wanted), actor.layers(inputs).clamp(-1, 1))
    for given in (None, torch.zeros(5, 1)):
        with pytest.raises(ValueError, match="takes 2 set-points"):
            actor(embedding, given)
    indifferent = Actor((-1.0,), (1.0,), 8, (4, 4), 0.0)
    assert torch.equal(indifferent(embedding, wanted), indifferent(embedding))


def test_the_predictor_takes_as_many_commands_as_it_was_made_for():
    predictor = Predictor(8, 16, action_dim=2)
    first, second = (predictor(unit(5, 8), torch.tensor([command] * 5)) for command in ((1.0, 0.0), (0.0, 1.0)))
    assert first.shape == (5, 8) and not torch.equal(first, second)


def test_the_probe_answers_in_the_units_of_the_state():
    probe = StateProbe(4, 8, 16)
    probe.state_mean.copy_(torch.tensor([1.0, 2.0, 3.0, 4.0]))
    probe.state_std.zero_()
    torch.testing.assert_close(probe(unit(2, 8)), torch.tensor([[1.0, 2.0, 3.0, 4.0]] * 2))
