"""What a device believes: the prediction, corrected by what it sees; kept in the zoo like every other part."""

import pytest
import tiny_controller
import torch
from torch.nn.functional import normalize

import tsjepa
from tsjepa.models import Observer, SemanticController, entries


def unit(*shape: int) -> torch.Tensor:
    return normalize(torch.randn(*shape), dim=-1)


def observing(seed: int = 0) -> SemanticController:
    """A tiny controller with an observer whose gain is no multiple of the identity."""
    model = tiny_controller.tiny(seed)
    torch.manual_seed(seed)
    model.observer = Observer(tiny_controller.DIM)
    with torch.no_grad():
        model.observer.correction.weight.add_(0.1 * torch.randn(tiny_controller.DIM, tiny_controller.DIM))
    return model


def test_a_gain_of_one_believes_what_it_sees_and_one_of_zero_what_was_predicted():
    predicted, seen = unit(5, 8), unit(5, 8)
    torch.testing.assert_close(Observer(8, gain=1.0)(predicted, seen), seen)
    torch.testing.assert_close(Observer(8, gain=0.0)(predicted, seen), predicted)


def test_a_new_gain_lies_on_the_way_and_the_belief_has_unit_length():
    predicted, seen = unit(3, 4, 8), unit(3, 4, 8)
    belief = Observer(8, gain=0.25)(predicted, seen)
    torch.testing.assert_close(belief, normalize(0.75 * predicted + 0.25 * seen, dim=-1))
    torch.testing.assert_close(belief.norm(dim=-1), torch.ones(3, 4))


def test_a_row_of_slots_is_believed_one_after_the_other():
    model = observing()
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


def test_an_entry_keeps_its_observer(tmp_path):
    model = observing()
    loaded = tsjepa.load(entries.save(model, tmp_path / "entry"))
    belief, command, seen = unit(3, tiny_controller.DIM), torch.randn(3, 1), unit(3, tiny_controller.DIM)
    assert torch.equal(loaded.correct(belief, command, seen), model.correct(belief, command, seen))
    assert tsjepa.load(entries.save(tiny_controller.tiny(), tmp_path / "plain")).observer is None
