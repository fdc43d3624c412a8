import colorsys

import numpy as np
import pytest
import torch

from tsjepa.data import augmentation as augmentation_module
from tsjepa.data.augmentation import LUMA, Augmentation
from tsjepa.models.encoder import PIXEL_MEAN, PIXEL_STD, Encoder, patchify

OFF = {"brightness": 0.0, "contrast": 0.0, "saturation": 0.0, "hue": 0.0, "grayscale": 0.0}


def frames(count: int = 4) -> torch.Tensor:
    return torch.randint(0, 256, (count, 2, 64, 128, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def colours(augmentation: Augmentation, rgb: torch.Tensor, seed: int = 0) -> torch.Tensor:
    """RGB in [0, 1] of one colour after each of 200 draws, normalisation undone."""
    maps = augmentation.draw(200, generator(seed))
    normalized = maps[..., :3] @ (255 * rgb) + maps[..., 3]
    return normalized * torch.tensor(PIXEL_STD) + torch.tensor(PIXEL_MEAN)


def test_without_strength_it_is_the_encoders_own_normalisation():
    expected = Encoder(widths=(4, 4, 4)).normalize(frames())
    torch.testing.assert_close(Augmentation(**OFF)(patchify(frames()), generator()), expected, atol=1e-4, rtol=1e-4)


def test_a_blurred_batch_is_the_blurred_frames_normalised():
    augmentation, encoder = Augmentation(**OFF, blur_sigma=(1.0, 1.0)), Encoder(widths=(4, 4, 4))
    expected = encoder.normalize(augmentation.blur(frames(), generator()))
    torch.testing.assert_close(augmentation(patchify(frames()), generator()), expected, atol=1e-4, rtol=1e-4)


def test_colour_dropping_keeps_the_luma():
    rgb = torch.tensor([0.8, 0.3, 0.1])
    grey = colours(Augmentation(**{**OFF, "grayscale": 1.0}), rgb)
    torch.testing.assert_close(grey, (torch.tensor(LUMA) @ rgb).expand(200, 3), atol=1e-4, rtol=1e-4)


def test_colour_dropping_has_the_stated_probability():
    dropped = colours(Augmentation(**{**OFF, "grayscale": 0.3}), torch.tensor([0.8, 0.3, 0.1]))
    share = ((dropped[:, 0] - dropped[:, 2]).abs() < 1e-3).float().mean()
    assert abs(share - 0.3) < 3 * (0.3 * 0.7 / 200) ** 0.5


def test_brightness_scales_within_its_range():
    rgb = torch.tensor([0.5, 0.4, 0.2])
    factors = colours(Augmentation(**{**OFF, "brightness": 0.05}), rgb) / rgb
    torch.testing.assert_close(factors[:, 0], factors[:, 2], atol=1e-4, rtol=1e-4)
    assert factors.min() >= 0.95 - 1e-4 and factors.max() <= 1.05 + 1e-4 and factors.std() > 0.02


def test_hue_keeps_the_luma_and_turns_the_hue_by_at_most_its_range():
    rgb = torch.tensor([0.6, 0.4, 0.3])
    turned = colours(Augmentation(**{**OFF, "hue": 0.05}), rgb)
    torch.testing.assert_close(
        turned @ torch.tensor(LUMA), (rgb @ torch.tensor(LUMA)).expand(200), atol=1e-3, rtol=1e-3
    )
    hues = np.array([colorsys.rgb_to_hsv(*colour)[0] for colour in turned.tolist()])
    change = (hues - colorsys.rgb_to_hsv(*rgb.tolist())[0] + 0.5) % 1 - 0.5
    assert 0.02 < np.abs(change).max() < 0.08  # the chroma plane's turn is not exactly HSV's


def test_consecutive_samples_share_a_draw():
    same = frames(1).expand(6, -1, -1, -1, -1)
    out = Augmentation()(patchify(same), generator(), shared=3)
    assert torch.equal(out[0], out[2]) and torch.equal(out[3], out[5]) and not torch.allclose(out[0], out[3])


def test_the_printed_blur_is_the_identity_and_a_wide_one_is_opencvs():
    import cv2

    printed = Augmentation(**OFF, blur_sigma=(0.1, 0.2))
    # 20 blurred values differ by at most four neighbours' weight of 4e-6 times 255
    assert (printed.blur(frames(), generator()) - frames()).abs().max() < 0.01
    wide = Augmentation(**OFF, blur_sigma=(1.5, 1.5)).blur(frames(), generator())
    for sample, frame in [(0, 0), (3, 1)]:
        expected = cv2.GaussianBlur(
            frames()[sample, frame].numpy().astype(np.float32), (5, 5), 1.5, borderType=cv2.BORDER_REFLECT_101
        )
        assert np.abs(wide[sample, frame].numpy() - expected).max() < 0.01


@pytest.mark.parametrize("dtype", [torch.bfloat16])
def test_under_autocast_it_stays_close_to_single_precision(dtype):
    exact = Augmentation()(patchify(frames()), generator())
    with torch.autocast("cpu", dtype):
        rounded = Augmentation()(patchify(frames()), generator())
    assert rounded.dtype == dtype
    assert (rounded.float() - exact).abs().mean() < 0.02


def test_a_batch_mapped_in_parts_is_the_batch_mapped_at_once_bit_for_bit():
    windows, stacks = 6, 3
    patches = patchify(frames(windows * stacks))
    augmentation = Augmentation(grayscale=0.5)
    with torch.autocast("cpu", torch.bfloat16):
        ours = augmentation(patches, generator(), shared=stacks)
        draws = augmentation.draw(windows, generator()).repeat_interleave(stacks, 0)
    matrix = torch.stack([torch.block_diag(*[draw[:, :3].T] * 16) for draw in draws]).bfloat16()
    offset = draws[:, None, :, 3].repeat(1, 1, 16).bfloat16()
    at_once = torch.baddbmm(offset, patches.view(len(patches), -1, 48).bfloat16(), matrix)
    assert torch.equal(ours, at_once.view(patches.shape))


def test_processes_share_the_draws_of_one(monkeypatch):
    """Colours and blur of a window are those that it has where one process has the whole batch."""
    windows, stacks = 4, 2
    patches = patchify(frames(windows * stacks)).unflatten(0, (windows, stacks))
    augmentation = Augmentation(blur_sigma=(0.5, 1.5))
    whole = augmentation(patches.flatten(0, 1), generator(), shared=stacks).unflatten(0, (windows, stacks))
    for rank in (0, 1):
        monkeypatch.setattr(augmentation_module, "rank_and_world_size", lambda rank=rank: (rank, 2))
        part = augmentation(patches[rank::2].flatten(0, 1), generator(), shared=stacks)
        torch.testing.assert_close(part, whole[rank::2].flatten(0, 1), atol=1e-5, rtol=1e-5)
