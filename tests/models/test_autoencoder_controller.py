"""The generative baseline's controller: reconstruct, estimate the state, apply the expert's law."""

import pytest
import tiny_controller
import torch

import tsjepa
from tsjepa.models import AutoencoderController, entries
from tsjepa.plants import CartPole


@pytest.fixture
def model():
    model = tiny_controller.tiny_autoencoder()
    model.law = CartPole().experts()["expert"]
    return model


@pytest.fixture
def embedding():
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(2, 3, tiny_controller.DIM, generator=generator), dim=-1)


def test_the_law_is_given_the_set_point(model, embedding):
    with torch.no_grad():
        state, wanted = model.probe(embedding), torch.full((2, 3, 1), 0.3)
        assert torch.equal(model.act(embedding, wanted), model.law(state, wanted))


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


def test_a_wanted_position_moves_the_law(model, embedding):
    with torch.no_grad():
        state = model.probe(embedding)
        wanted = torch.full((2, 3, 1), 0.1)
        assert torch.equal(model.act(embedding, wanted), model.law(state, wanted))


def test_it_says_that_it_predicts_nothing(model, embedding):
    assert not model.has_predictor
    with pytest.raises(ValueError, match="no predictor"):
        model.predict(embedding, torch.zeros(2, 3, 1))


def test_it_is_an_entry_of_the_zoo_like_any_other(model, embedding, tmp_path):
    loaded = tsjepa.load(entries.save(model, tmp_path / "entry"))
    assert isinstance(loaded, AutoencoderController)
    assert torch.equal(loaded.act(embedding), model.act(embedding))
    assert torch.equal(loaded.decode(embedding), model.decode(embedding))
