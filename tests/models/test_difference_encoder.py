"""The encoder of the newest frame and its differences to the older ones."""

import pytest
import torch
from torch.nn import functional as F

from tsjepa.models import DifferenceEncoder
from tsjepa.models.encoder import LUMA, PIXEL_MEAN, PIXEL_STD

SIZES = {"embedding_dim": 8, "height": 8, "width": 12, "features": 6, "hidden_dim": 10}


def frames(count: int, stack: int = 2, height: int = 8, width: int = 12) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(0, 256, (count, stack, height, width, 3), dtype=torch.uint8, generator=generator)


def luma(stacks: torch.Tensor) -> torch.Tensor:
    """Luma of normalised pixels in float64, in the order of rows and columns."""
    normal = (stacks.double() / 255 - torch.tensor(PIXEL_MEAN).double()) / torch.tensor(PIXEL_STD).double()
    return normal @ torch.tensor(LUMA).double()


@pytest.mark.parametrize("stack", [1, 2, 3])
def test_it_is_the_map_of_the_newest_frame_and_of_each_difference_then_a_residual_network(stack):
    encoder, stacks = DifferenceEncoder(stack, **SIZES).eval(), frames(5, stack)
    encoder.norm.running_mean.normal_(generator=torch.Generator().manual_seed(1))
    encoder.norm.running_var.fill_(3.0)
    wanted = {name: value.double() for name, value in encoder.state_dict().items()}
    # the map's columns follow the patches; put them into the order of rows and columns
    weight = wanted["describe.weight"].reshape(6, 2, 3, 4, 4).permute(0, 1, 3, 2, 4).flatten(1)
    grey = luma(stacks).flatten(2)
    newest = grey[:, -1]
    described = [newest @ weight.T, *((newest - grey[:, older]) @ weight.T for older in range(stack - 1))]
    normal = (torch.cat(described, 1) - wanted["norm.running_mean"]) / (3.0 + encoder.norm.eps) ** 0.5
    entered = F.relu(normal @ wanted["enter.weight"].T + wanted["enter.bias"])
    hidden = entered + F.relu(entered @ wanted["hidden.weight"].T + wanted["hidden.bias"])
    expected = F.normalize(hidden @ wanted["project.weight"].T + wanted["project.bias"], dim=-1)
    with torch.no_grad():
        torch.testing.assert_close(encoder(stacks).double(), expected, atol=2e-5, rtol=1e-4)


def test_a_motion_of_a_hundredth_survives_bfloat16():
    """The map of the difference keeps what the difference of two maps would round away."""
    encoder = DifferenceEncoder(2, **SIZES).eval()
    generator = torch.Generator().manual_seed(2)
    older = torch.rand(64, 96, generator=generator) * 100
    moved = torch.randn(64, 96, generator=generator) * 0.5
    patches = torch.stack((older - moved, older), dim=1).reshape(64, 2, 6, 16).transpose(1, 2).reshape(64, 2, 3, 32)
    seen = []
    encoder.norm.register_forward_hook(lambda module, inputs, output: seen.append(inputs[0][:, 6:]))
    with torch.no_grad():
        encoder.embed(patches)
        with torch.autocast("cpu", torch.bfloat16):
            encoder.embed(patches)
    exact, rounded = seen
    assert (rounded - exact).abs().max() < 0.02 * exact.abs().max()


def test_with_widths_every_frame_goes_through_the_same_convolutions():
    sizes = SIZES | {"height": 32, "width": 64, "widths": (4, 6, 8)}
    encoder, stacks = DifferenceEncoder(3, **sizes).eval(), frames(4, 3, 32, 64)
    with torch.no_grad():
        single = [
            encoder.describe(encoder.stages(encoder.stem(picture)).permute(0, 2, 3, 1).flatten(1))
            for picture in (
                encoder.normalize(stacks[:, [place] * 3])[..., :16].permute(0, 3, 1, 2) for place in range(3)
            )
        ]
        described = torch.stack((single[2], single[2] - single[0], single[2] - single[1]), dim=1)
        entered = F.relu(encoder.enter(encoder.norm(described.flatten(1))))
        expected = F.normalize(encoder.project(entered + F.relu(encoder.hidden(entered))), dim=-1)
        torch.testing.assert_close(encoder(stacks), expected, atol=1e-5, rtol=1e-4)
        still = encoder.convolved(encoder.normalize(stacks[:, [1, 1, 1]]).unflatten(3, (3, -1)).movedim(3, 1))
    assert (still[:, 1:] == 0).all()


def test_the_batch_shape_is_kept_and_other_frames_are_refused():
    encoder = DifferenceEncoder(2, **SIZES).eval()
    with torch.no_grad():
        embedding = encoder(frames(6).unflatten(0, (2, 3)))
    assert embedding.shape == (2, 3, 8)
    torch.testing.assert_close(embedding.norm(dim=-1), torch.ones(2, 3))
    with pytest.raises(ValueError, match="stack the frames oldest first"):
        encoder(frames(6, stack=3))


def test_colours_of_one_luma_look_alike_only_to_a_grey_one():
    red = torch.zeros(1, 2, 8, 12, 3)
    red[..., 0] = 100.0
    green = torch.zeros_like(red)
    std = torch.tensor(PIXEL_STD)
    green[..., 1] = 100.0 * (LUMA[0] / std[0]) / (LUMA[1] / std[1])
    pair = torch.cat((red, green)).round().to(torch.uint8)
    for grey, alike in ((True, True), (False, False)):
        encoder = DifferenceEncoder(2, **SIZES, grey=grey).eval()
        with torch.no_grad():
            first, second = encoder(pair)
        assert (float((first - second).norm()) < 0.02) == alike


def test_sizes_that_make_no_network_are_refused():
    with pytest.raises(ValueError, match="features"):
        DifferenceEncoder(2, 8, 8, 12, features=0)
    with pytest.raises(ValueError, match="multiples of 32"):
        DifferenceEncoder(2, 8, 8, 12, widths=(4, 6, 8))


def test_a_frame_that_makes_no_whole_patches_is_refused():
    with pytest.raises(ValueError, match="sides are multiples of 4, not 45 x 80"):
        DifferenceEncoder(height=45, width=80)
