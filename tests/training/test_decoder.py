import pytest
import torch

from tsjepa.models import Architecture, SemanticController
from tsjepa.models.decoder import Decoder
from tsjepa.models.encoder import patchify
from tsjepa.training.decoder import fit_decoder, median_frame, reconstruction_loss

D = 8


@pytest.fixture(scope="module")
def squares():
    """Embeddings [64, D], the frame each stands for (a white square in one of D places), and the frame without it."""
    place = torch.arange(64) % D
    background = torch.linspace(20, 120, 128)[None, :, None].expand(64, 128, 3).to(torch.uint8)
    frames = background.repeat(64, 1, 1, 1)
    for frame, column in zip(frames, (13 * place).tolist(), strict=True):
        frame[20:44, column : column + 20] = 255
    return torch.eye(D)[place], frames, background


def test_the_background_is_the_frame_without_what_moves(squares):
    _, frames, background = squares
    torch.testing.assert_close(median_frame(frames), patchify(background[None, None])[0].float())


def test_the_decoder_learns_to_draw_what_the_embedding_tells_and_repeats_itself(squares):
    embedding, frames, background = squares
    drawn = []
    for _ in range(2):
        torch.manual_seed(0)
        decoder = Decoder(D, widths=(16, 16, 8, 8))
        fit_decoder(decoder, embedding, frames, steps=120, batch_size=16, learning_rate=1e-2)
        assert not decoder.training
        with torch.no_grad():
            drawn.append(decoder(embedding)[:, 0])
    assert torch.equal(*drawn)
    assert drawn[0].shape == frames.shape
    assert drawn[0].min() >= 0 and drawn[0].max() <= 255
    truth = frames.float()
    assert (drawn[0] - truth).square().mean() < 0.6 * (background - truth).square().mean()


def test_the_reconstruction_loss_weighs_by_the_distance_to_the_background():
    patches = torch.tensor([0, 51, 255], dtype=torch.uint8)[None]
    drawn = torch.tensor([[0.1, 0.2, 0.5]])
    loss = reconstruction_loss(drawn, patches, torch.zeros(3), foreground_weight=10.0)
    # deviations 0, 0.2 and 1, weights 1, 3 and 11, errors 0.1, 0 and 0.5
    torch.testing.assert_close(loss, torch.tensor((1 * 0.01 + 3 * 0 + 11 * 0.25) / 3))


def test_a_controller_whose_decoder_nobody_trained_says_so_and_else_draws_one_frame():
    model = SemanticController(Architecture(widths=(4, 8, 8), embedding_dim=D)).eval()
    with pytest.raises(ValueError, match="never trained"):
        model.decode(torch.eye(D))
    model.decoder.fitted.fill_(True)
    assert model.decode(torch.eye(D).expand(2, D, D)).shape == (2, D, 64, 128, 3)


def test_a_controller_without_predictor_says_so():
    model = SemanticController(Architecture(widths=(4, 8, 8), embedding_dim=D, has_predictor=False))
    with pytest.raises(ValueError, match="no predictor"):
        model.predict(torch.eye(D), torch.zeros(D, 1))
