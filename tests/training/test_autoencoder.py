import copy
from types import SimpleNamespace

import pytest
import tiny_controller
import torch
from torch.nn import functional as F

from tsjepa.models import Decoder, Encoder, StateEstimator
from tsjepa.models.encoder import patchify
from tsjepa.training.autoencoder import Autoencoder, fit_estimator
from tsjepa.training.finish.decoder import fit_background

D = 8


@pytest.mark.slow
def test_the_estimator_learns_to_read_what_the_frozen_decoder_draws_and_nothing_else_changes():
    model = tiny_controller.tiny_autoencoder()
    torch.manual_seed(0)
    model.decoder, model.estimator = Decoder(D, 2, (16, 16, 8, 8)), StateEstimator(4, 2, (8, 16, 16), 64, 128)
    before = copy.deepcopy(model.state_dict())
    generator = torch.Generator().manual_seed(0)
    embedding = F.normalize(torch.randn(48, D, generator=generator), dim=-1)
    state = embedding[:, :4] * torch.tensor([1.0, 0.1, 5.0, 2.0]) + 3
    fit_estimator(model, embedding, state, steps=100, batch_size=48, learning_rate=1e-2)
    with torch.no_grad():
        error = (model.probe(embedding) - state).square().mean(0).sqrt() / state.std(0)
    assert (error < 0.5).all()
    changed = {name for name, value in model.state_dict().items() if not torch.equal(value, before[name])}
    assert changed and all(name.startswith("estimator.") for name in changed)
    assert not any(part.training for part in model.modules())


def test_reconstructing_lowers_the_loss_on_the_same_stacks():
    torch.manual_seed(0)
    encoder = Encoder(2, (4, 8, 8), D)
    module = Autoencoder(encoder, Decoder(D, 2, channels=(16, 16, 8, 8)))
    module.model = SimpleNamespace(encoder=encoder, decoder=module.decoder)
    frames = torch.full((8, 2, 64, 128, 3), 60, dtype=torch.uint8)
    for index, stack in enumerate(frames):
        stack[:, 20:44, 12 * index : 12 * index + 24] = 255
    fit_background(module.decoder, frames[:, 1], contrast_floor=20.0)
    optimizer = torch.optim.AdamW(module.parameters(), 1e-2)
    losses = []
    for _ in range(25):
        loss = module.reconstruction(patchify(frames))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.6 * losses[0]
    # each part has learnt, the encoder through the decoder
    assert all(parameter.grad.abs().max() > 0 for parameter in (encoder.project.weight, encoder.stem[0].weight))


@pytest.mark.parametrize("sizes", [(D, 1), (2 * D, 2)])
def test_an_encoder_and_a_decoder_that_do_not_fit_are_refused(sizes):
    with pytest.raises(ValueError, match="give them the same"):
        Autoencoder(Encoder(2, (4, 8, 8), D), Decoder(*sizes))
