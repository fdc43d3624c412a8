"""The generative baseline's controller: reconstruct, estimate the state, apply the expert's law."""

import pytest
import tiny_controller
import torch

import tsjepa
from tsjepa.models import AutoencoderController, Decoder, StateEstimator, entries
from tsjepa.plants import CartPole
from tsjepa.plants.lqr import ClippedLQR


@pytest.fixture
def model():
    model = tiny_controller.tiny_autoencoder()
    model.law = CartPole().experts()["expert"]
    return model


@pytest.fixture
def embedding():
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(2, 3, tiny_controller.DIM, generator=generator), dim=-1)


def test_the_command_is_the_laws_for_the_state_that_is_read_and_the_place_that_is_wanted(model, embedding):
    """An estimator of one state, whatever is drawn, leaves a command that can be worked out by hand."""
    state, gain = torch.tensor([0.2, -0.1, 0.3, 0.4]), torch.tensor([[2.0, -3.0, 4.0, 5.0]])
    model.law = ClippedLQR(gain, 0.5, model.spec.action_low, model.spec.action_high)
    with torch.no_grad():
        for tensor in model.estimator.output.parameters():
            tensor.zero_()
        model.estimator.state_mean.copy_(state)
        at_zero, at_tenth = model.act(embedding), model.act(embedding, torch.full((2, 3, 1), 0.1))
    assert at_zero.shape == (2, 3, 1)
    by_hand = -(2.0 * 0.2 + 3.0 * 0.1 + 4.0 * 0.3 + 5.0 * 0.4)
    torch.testing.assert_close(at_zero, torch.full((2, 3, 1), by_hand))
    torch.testing.assert_close(at_tenth, torch.full((2, 3, 1), by_hand + 2.0 * 0.1))


def test_the_command_is_the_law_applied_to_the_state_read_from_the_reconstruction(model, embedding):
    with torch.no_grad():
        state, force, frame = model.probe(embedding), model.act(embedding), model.decode(embedding)
        one = model.estimator(model.decoder.draw(embedding[1, 2:3]))
        stack = model.decoder(embedding)
    assert (state.shape, force.shape, frame.shape) == ((2, 3, 4), (2, 3, 1), (2, 3, 64, 128, 3))
    assert torch.equal(force, model.law(state))
    torch.testing.assert_close(state[1, 2], one[0])
    assert stack.shape == (2, 3, 2, 64, 128, 3)
    assert torch.equal(frame, stack[:, :, 1])
    frames = torch.zeros(5, 2, 64, 128, 3, dtype=torch.uint8)
    assert model.encode(frames).shape == (5, tiny_controller.DIM)


def test_it_says_that_it_predicts_nothing(model, embedding):
    assert not model.has_predictor
    with pytest.raises(ValueError, match="no predictor"):
        model.predict(embedding, torch.zeros(2, 3, 1))


def test_it_is_an_entry_of_the_zoo_like_any_other(model, embedding, tmp_path):
    loaded = tsjepa.load(entries.save(model, tmp_path / "entry"))
    assert isinstance(loaded, AutoencoderController)
    assert torch.equal(loaded.act(embedding), model.act(embedding))
    assert torch.equal(loaded.decode(embedding), model.decode(embedding))


@pytest.mark.parametrize(("height", "width"), [(48, 48), (40, 76), (64, 128)])
def test_frames_of_any_whole_patches_are_drawn_and_read(height, width):
    decoder, estimator = Decoder(8, 2, (8, 4, 4, 4), height, width), StateEstimator(3, 2, (4, 8, 8), height, width)
    drawn = decoder.draw(torch.nn.functional.normalize(torch.randn(5, 8), dim=-1))
    assert drawn.shape == (5, height // 4, width // 4, 96)
    assert estimator(drawn).shape == (5, 3)
