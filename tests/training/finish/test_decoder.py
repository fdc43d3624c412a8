import pytest
import tiny_controller
import torch
from tensordict import TensorDict
from torch.nn import functional as F

from tsjepa.models.decoder import Decoder
from tsjepa.models.encoder import unpatchify
from tsjepa.training.finish.decoder import NewestFrames, fit_background, fit_decoder, reconstruction_loss

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
    decoder = Decoder(D, frame_stack=2, channels=(16, 16, 8, 8))
    fit_background(decoder, frames)
    torch.testing.assert_close(unpatchify(decoder.background[None])[0], background.float().expand(2, 64, 128, 3))


@pytest.mark.parametrize(("floor", "expected"), [(5.0, 50 / 5**0.5), (30.0, 30.0)])
def test_contrast_is_the_distance_to_the_background_or_its_floor(floor, expected):
    frames = torch.full((10, 64, 128, 3), 100, dtype=torch.uint8)
    frames[::5] += 50
    decoder = Decoder(D, channels=(16, 16, 8, 8))
    fit_background(decoder, frames, contrast_floor=floor)
    torch.testing.assert_close(decoder.contrast, torch.full((16, 32, 48), expected))


def test_contrast_falls_off_smoothly_around_what_moves(squares):
    decoder = Decoder(D, channels=(16, 16, 8, 8))
    fit_background(decoder, squares[1], contrast_floor=1.0)
    column = unpatchify(decoder.contrast[None])[0, 0, :, 64, 0]
    # the squares cover rows 20 to 43, and a row more or less within reach changes the mean square by a seventeenth
    assert (column.square().diff().abs() <= column.square().max() / 17 + 1e-3).all()
    assert (column[:12] == 1).all() and (column[52:] == 1).all() and (column[28:36] == column[28:36].max()).all()


@pytest.mark.slow
def test_the_decoder_learns_to_draw_what_the_embedding_tells_and_repeats_itself(squares):
    embedding, frames, background = squares
    drawn = []
    for _ in range(2):
        torch.manual_seed(0)
        decoder = Decoder(D, channels=(16, 16, 8, 8))
        fit_decoder(decoder, embedding, frames, steps=120, batch_size=16, learning_rate=1e-2)
        assert not decoder.training
        with torch.no_grad():
            drawn.append(decoder(embedding)[:, 0])
    assert torch.equal(*drawn)
    assert drawn[0].shape == frames.shape
    assert drawn[0].min() >= 0 and drawn[0].max() <= 255
    truth = frames.float()
    assert (drawn[0] - truth).square().mean() < 0.6 * (background - truth).square().mean()


def test_the_reconstruction_loss_is_the_squared_error_in_units_of_contrast():
    decoder = Decoder(D, channels=(16, 16, 8, 8))
    decoder.background.fill_(100)
    decoder.contrast.fill_(50)
    generator = torch.Generator().manual_seed(0)
    patches = torch.randint(0, 256, (2, 16, 32, 48), dtype=torch.uint8, generator=generator)
    drawn = torch.randn(2, 16, 32, 48, generator=generator).requires_grad_()
    expected = F.mse_loss(drawn, (patches.float() - 100) / 50)
    loss = reconstruction_loss(decoder, drawn, patches)
    torch.testing.assert_close(loss, expected)
    torch.testing.assert_close(torch.autograd.grad(3 * loss, drawn), torch.autograd.grad(3 * expected, drawn))


def test_the_motion_weight_counts_errors_that_differ_from_frame_to_frame():
    decoder = Decoder(D, frame_stack=3, channels=(16, 16, 8, 8))
    patches = torch.full((2, 16, 32, 144), 7, dtype=torch.uint8)
    same, growing = torch.full((2, 16, 32, 144), 7.5), torch.full((2, 16, 32, 144), 7.0)
    growing[..., 48:96] += 1
    growing[..., 96:] += 3
    loss = [
        [reconstruction_loss(decoder, drawn, patches, weight) for weight in (0.0, 10.0)] for drawn in (same, growing)
    ]
    assert loss[0] == [0.25, 0.25]
    one = reconstruction_loss(Decoder(D, channels=(16, 16, 8, 8)), same[..., :48], patches[..., :48], 10.0)
    assert one == 0.25
    # frames off by 0, 1, 3, their differences by 1, 2
    torch.testing.assert_close(torch.stack(loss[1]), torch.tensor([10 / 3, 10 / 3 + 10 * 5 / 2]))


def test_a_controller_whose_decoder_nobody_trained_says_so_and_else_draws_one_frame():
    model = tiny_controller.tiny()
    model.decoder.fitted.fill_(False)
    with pytest.raises(ValueError, match="never trained"):
        model.decode(torch.eye(D))
    model.decoder.fitted.fill_(True)
    assert model.decode(torch.eye(D).expand(2, D, D)).shape == (2, D, 64, 128, 3)


def test_a_controller_without_predictor_says_so():
    with pytest.raises(ValueError, match="no predictor"):
        tiny_controller.tiny_supervised().predict(torch.eye(D), torch.zeros(D, 1))


def test_frames_are_read_from_the_maps_when_they_are_asked_for(tmp_path):
    """Those are the newest of every stack, split after split, and no copy of a split is made."""
    generator = torch.Generator().manual_seed(0)
    splits = []
    for index, episodes in enumerate((3, 2)):
        pixels = torch.randint(0, 256, (episodes, 5, 4, 8, 3), dtype=torch.uint8, generator=generator)
        TensorDict({"pixels": pixels}, batch_size=[episodes, 5]).memmap(tmp_path / str(index))
        splits.append(TensorDict.load_memmap(tmp_path / str(index)))
    frames = NewestFrames(splits, 2)
    expected = torch.cat([split["pixels"][:, 2:].clone().flatten(0, 1) for split in splits])
    assert len(frames) == len(expected) == 15
    assert torch.equal(frames[torch.arange(15)], expected)
    rows = torch.tensor([14, 0, 9, 8, 0])
    assert torch.equal(frames[rows], expected[rows])
    addresses = [split["pixels"].data_ptr() for split in splits]
    assert [pixels.data_ptr() for pixels in frames.pixels.pixels] == addresses
