"""What a device believes: the prediction, corrected by what it sees; kept in the zoo like every other part."""

import pytest
import tiny_controller
import torch
from torch.nn.functional import normalize

import tsjepa
from tsjepa.models import Observer, SemanticController, entries


def unit(*shape: int) -> torch.Tensor:
    return normalize(torch.randn(*shape), dim=-1)


def observing(seed: int = 0, **options) -> SemanticController:
    """A tiny controller with an observer whose gain is no multiple of the identity, and whose network is not zero."""
    model = tiny_controller.tiny(seed)
    torch.manual_seed(seed)
    model.observer = Observer(tiny_controller.DIM, **options)
    with torch.no_grad():
        for weights in model.observer.parameters():
            weights.add_(0.1 * torch.randn_like(weights))
    return model


COMMANDED, BLIND = {"hidden_dim": 12}, {"hidden_dim": 12, "memory": False}
KINDS = [{}, COMMANDED, BLIND]


def test_a_gain_of_one_believes_what_it_sees_and_one_of_zero_what_was_predicted():
    predicted, seen, command = unit(5, 8), unit(5, 8), torch.randn(5, 1)
    torch.testing.assert_close(Observer(8, gain=1.0)(predicted, seen, command), seen)
    torch.testing.assert_close(Observer(8, gain=0.0)(predicted, seen, command), predicted)


def test_a_new_gain_lies_on_the_way_and_the_belief_has_unit_length():
    predicted, seen = unit(3, 4, 8), unit(3, 4, 8)
    belief = Observer(8, gain=0.25)(predicted, seen, torch.randn(3, 4, 1))
    torch.testing.assert_close(belief, normalize(0.75 * predicted + 0.25 * seen, dim=-1))
    torch.testing.assert_close(belief.norm(dim=-1), torch.ones(3, 4))


def test_a_new_network_changes_nothing():
    predicted, seen, command = unit(5, 8), unit(5, 8), torch.randn(5, 1)
    torch.testing.assert_close(
        Observer(8, hidden_dim=12)(predicted, seen, command), Observer(8)(predicted, seen, command)
    )
    torch.testing.assert_close(Observer(8, hidden_dim=12, memory=False)(predicted, seen, command), seen)


def test_what_a_stack_shows_is_expected_from_what_was_predicted_and_the_last_command():
    observer = Observer(2, gain=0.5, hidden_dim=1)
    with torch.no_grad():
        observer.hidden.weight.copy_(torch.tensor([[0.0, 0.0, 1.0]]))  # the command alone
        observer.hidden.bias.zero_()
        observer.shown.weight.copy_(torch.tensor([[0.0], [1.0]]))  # moves the second number by it
    observer.command_mean.fill_(3.0)
    observer.command_std.fill_(2.0)
    predicted, seen, command = torch.tensor([1.0, 0.0]), torch.tensor([0.6, 0.8]), torch.tensor([7.0])
    expected = normalize(torch.tensor([1.0, (7.0 - 3.0) / 2.0 / 2**0.5]), dim=-1)
    torch.testing.assert_close(
        observer(predicted, seen, command), normalize(predicted + 0.5 * (seen - expected), dim=-1)
    )


def test_one_without_memory_does_not_read_what_was_predicted():
    seen, command = unit(5, tiny_controller.DIM), torch.randn(5, 1)
    for options, alike in ((COMMANDED, False), (BLIND, True)):
        model = observing(**options)
        first, second = (model.correct(unit(5, tiny_controller.DIM), command, seen) for _ in range(2))
        assert torch.equal(first, second) == alike
        assert not torch.equal(first, model.correct(first, command + 1, seen))


def test_one_without_memory_and_network_is_refused():
    with pytest.raises(ValueError, match="give it a hidden_dim"):
        Observer(8, memory=False)


@pytest.mark.parametrize("options", KINDS)
def test_a_row_of_slots_is_believed_one_after_the_other(options):
    model = observing(**options)
    seen, commands = unit(2, 4, tiny_controller.DIM), torch.randn(2, 3, 1)
    belief = seen[:, 0]
    for slot in range(3):
        belief = model.correct(belief, commands[:, slot], seen[:, slot + 1])
    torch.testing.assert_close(model.belief_after(seen, commands), belief)
    torch.testing.assert_close(model.belief_after(seen[:, :1], commands[:, :0]), seen[:, 0])


def test_a_controller_without_one_says_so():
    model = tiny_controller.tiny()
    with pytest.raises(ValueError, match="no observer"):
        model.correct(unit(1, 8), torch.zeros(1, 1), unit(1, 8))


@pytest.mark.parametrize("options", KINDS)
def test_an_entry_keeps_its_observer(tmp_path, options):
    model = observing(**options)
    loaded = tsjepa.load(entries.save(model, tmp_path / "entry"))
    belief, command, seen = unit(3, tiny_controller.DIM), torch.randn(3, 1), unit(3, tiny_controller.DIM)
    assert torch.equal(loaded.correct(belief, command, seen), model.correct(belief, command, seen))
    assert tsjepa.load(entries.save(tiny_controller.tiny(), tmp_path / "plain")).observer is None
