import pytest
import torch
from tsjepa.plants.expert import Expert

import tsjepa
from tsjepa.models import AutoencoderArchitecture, AutoencoderController, entries
from tsjepa.models.autoencoder import ClippedLinearLaw

SMALL = AutoencoderArchitecture(
    widths=(4, 8, 8), embedding_dim=8, decoder_channels=(8, 8, 4, 4), estimator_channels=(4, 8, 8)
)


@pytest.fixture
def model():
    torch.manual_seed(0)
    model = AutoencoderController(SMALL).eval()
    expert = Expert(SMALL.sampling_interval)
    model.law.gain.copy_(expert.gain)
    model.law.position_clip.fill_(expert.position_clip)
    model.decoder.fitted.fill_(True)
    return model


@pytest.fixture
def embedding():
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(2, 3, 8, generator=generator), dim=-1)


def test_the_law_is_the_experts(model):
    generator = torch.Generator().manual_seed(0)
    state = torch.randn(500, 4, generator=generator) * torch.tensor([1.0, 0.2, 1.0, 1.0])
    force = model.law(state)
    torch.testing.assert_close(force, Expert(SMALL.sampling_interval)(state))
    assert (force.abs() == 20).any() and (state[:, 0].abs() > model.law.position_clip).any()


def test_a_law_without_numbers_gives_none():
    assert ClippedLinearLaw()(torch.zeros(4)).isnan().all()


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
    assert model.encode(frames).shape == (5, 8)


def test_it_says_that_it_predicts_nothing(model, embedding):
    assert not model.has_predictor
    with pytest.raises(ValueError, match="no predictor"):
        model.predict(embedding, torch.zeros(2, 3, 1))


def test_it_is_an_entry_of_the_zoo_like_any_other(model, embedding, tmp_path):
    loaded = tsjepa.load(entries.save(model, tmp_path / "entry"))
    assert isinstance(loaded, AutoencoderController)
    assert loaded.architecture == SMALL
    assert torch.equal(loaded.act(embedding), model.act(embedding))
    assert torch.equal(loaded.decode(embedding), model.decode(embedding))
