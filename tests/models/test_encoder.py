import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch.nn import functional as F

import tsjepa
from tsjepa.models import Encoder
from tsjepa.models.encoder import PIXEL_MEAN, PIXEL_STD, ResidualBlock, patchify, unpatchify


def frames(count: int, stack: int = 2, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (count, stack, 64, 128, 3), dtype=torch.uint8, generator=generator)


def test_patchify_puts_every_pixel_where_its_indices_say():
    stacks = frames(2)
    assert torch.equal(unpatchify(patchify(stacks)), stacks)
    patches = patchify(stacks).reshape(2, 16, 32, 2, 4, 4, 3)
    for sample, frame, row, column, color in [(0, 0, 0, 0, 0), (1, 1, 63, 127, 2), (0, 1, 17, 90, 1)]:
        expected = stacks[sample, frame, row, column, color]
        assert patches[sample, row // 4, column // 4, frame, row % 4, column % 4, color] == expected


def test_normalisation_is_the_per_channel_affine_map_of_the_paper():
    stacks = frames(3)
    mean, std = torch.tensor(PIXEL_MEAN), torch.tensor(PIXEL_STD)
    expected = patchify((stacks / 255 - mean) / std)
    torch.testing.assert_close(Encoder(widths=(4, 4, 4)).normalize(stacks), expected, atol=1e-5, rtol=1e-5)


def test_normalisation_in_place_changes_neither_a_bit_nor_the_frames():
    stacks, encoder = frames(3), Encoder(widths=(4, 4, 4))
    expected = patchify(stacks).float() * encoder.pixel_scale + encoder.pixel_shift
    before = stacks.clone()
    assert torch.equal(encoder.normalize(stacks), expected)
    assert torch.equal(stacks, before)


def test_a_fleets_embeddings_in_bfloat16_agree_with_float32():
    from tsjepa.plants import CartPole

    model = tsjepa.load("tsjepa-cartpole")
    plant, rows = CartPole(0.02), np.arange(32)
    scenes = plant.scene(plant.start(0, rows, 0 * rows), 0, rows, 0 * rows)
    pictures = torch.from_numpy(plant.render(scenes)).unflatten(0, (16, 2))
    with torch.no_grad():
        exact = model.encode(pictures)
        with torch.autocast("cpu", torch.bfloat16):
            ours = model.encode(pictures)
        assert torch.nn.functional.cosine_similarity(ours, exact).min() > 0.9998
        # in newtons, of commands that reach 20
        assert (model.act(ours) - model.act(exact)).abs().max() < 0.4


def test_embeddings_have_unit_length_and_the_batch_shape_of_the_frames():
    encoder = Encoder(widths=(4, 8, 8), embedding_dim=16).eval()
    embedding = encoder(frames(6).unflatten(0, (2, 3)))
    assert embedding.shape == (2, 3, 16)
    torch.testing.assert_close(embedding.norm(dim=-1), torch.ones(2, 3))
    torch.testing.assert_close(encoder(frames(6)[4]), embedding[1, 1], atol=1e-6, rtol=1e-5)


def test_evaluation_mode_does_not_depend_on_the_rest_of_the_batch():
    encoder = Encoder(widths=(4, 8, 8), embedding_dim=16)
    encoder(frames(8))
    encoder.eval()
    torch.testing.assert_close(encoder(frames(8))[:2], encoder(frames(8)[:2]), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("bad", [frames(2, stack=3), frames(2).float(), frames(2)[..., :64, :]])
def test_wrong_frames_are_refused_with_their_shape(bad):
    with pytest.raises(ValueError, match="uint8 frames of shape"):
        Encoder(widths=(4, 4, 4))(bad)


AVX2 = {"ONEDNN_MAX_CPU_ISA": "AVX2", "ATEN_CPU_CAPABILITY": "avx2"}
TRAIN_A_NARROW_ENCODER = """
import torch
from tsjepa.models import Encoder
encoder = Encoder(2, ({width}, 8, 8), 16)
for _ in range(10):
    encoder.embed(torch.randn(16, 16, 32, 96)).square().sum().backward()
"""


@pytest.mark.slow
@pytest.mark.parametrize("width", [2, 4, 6])
def test_a_narrow_encoder_trains_on_an_avx2_cpu_without_corrupting_memory(width):
    program = TRAIN_A_NARROW_ENCODER.format(width=width)
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | AVX2 | {"MALLOC_CHECK_": "3", "OMP_NUM_THREADS": "1"}
    )
    assert done.returncode == 0


def test_the_shortcut_is_the_strided_convolution():
    torch.manual_seed(0)
    block = ResidualBlock(12, 8, 2).eval()
    picture = torch.randn(3, 12, 16, 32, generator=torch.Generator().manual_seed(0))
    weight = block.shortcut[0].weight
    straight = F.relu(block.norm1(block.conv1(picture)))
    expected = F.relu(block.norm2(block.conv2(straight)) + block.shortcut[1](F.conv2d(picture, weight, stride=2)))
    torch.testing.assert_close(block(picture), expected)


def test_the_gradient_of_a_channels_last_picture_is_channels_last():
    picture = torch.randn(2, 8, 16, 32).contiguous(memory_format=torch.channels_last).requires_grad_()
    ResidualBlock(8, 8, 2).to(memory_format=torch.channels_last)(picture).sum().backward()
    assert picture.grad.is_contiguous(memory_format=torch.channels_last)


@pytest.mark.parametrize(("kernel", "reach"), [(1, 0), (3, 1), (5, 2)])
def test_the_stem_sees_as_many_patches_as_its_kernel_has(kernel, reach):
    stem = Encoder(widths=(4, 4, 4), stem_kernel=kernel).stem[0]
    picture = torch.zeros(1, 96, 16, 32, requires_grad=True)
    stem(picture)[0, :, 8, 16].sum().backward()
    rows, columns = picture.grad[0].abs().sum(0).nonzero().unbind(1)
    assert (rows.min(), rows.max()) == (8 - reach, 8 + reach)
    assert (columns.min(), columns.max()) == (16 - reach, 16 + reach)


def test_a_stem_without_a_middle_is_refused():
    with pytest.raises(ValueError, match="stem_kernel = 2 is even"):
        Encoder(stem_kernel=2)
