"""The context encoder: a stack of frames to one embedding on the unit sphere."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.support.checks import at_least

# ImageNet statistics, as the paper's "Normalization" step prints them.
PIXEL_MEAN = (0.485, 0.456, 0.406)
PIXEL_STD = (0.229, 0.224, 0.225)
LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601, the luma component that colour dropping keeps


PATCH = 4  # pixels; the stem sees the picture as patches of this side


def patchify(frames: Tensor) -> Tensor:
    """Rearranges stacks of frames into patches, without arithmetic.

    Args:
        frames: [N, frame_stack, H, W, C], any dtype.

    Returns:
        [N, H / 4, W / 4, frame_stack * 16 * C]; the channels run over frame, row, column, colour.
    """
    count, stack, height, width, colors = frames.shape
    rows = frames.reshape(count, stack, height // PATCH, PATCH, width // PATCH, PATCH * colors)
    # stacking the few row slices copies runs of 12 bytes and is three times faster than one six-axis permutation
    slices = [rows[:, frame, :, row] for frame in range(stack) for row in range(PATCH)]
    return torch.stack(slices, dim=3).flatten(3)


def unpatchify(patches: Tensor) -> Tensor:
    """Puts patches [N, H / 4, W / 4, frame_stack * 48] together again: [N, frame_stack, H, W, 3]."""
    count, rows, columns, channels = patches.shape
    cut = patches.reshape(count, rows, columns, channels // (3 * PATCH**2), PATCH, PATCH, 3)
    return cut.permute(0, 3, 1, 4, 2, 5, 6).reshape(count, -1, rows * PATCH, columns * PATCH, 3)


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with batch normalisation and a projected shortcut (He et al., 2016).

    The shortcut takes every ``stride``-th pixel, then a 1x1 convolution of stride 1. A strided 1x1 convolution is the
    same map, but oneDNN (torch 2.13 on a CPU) writes past the end of its weights' gradient with fewer than 8 input
    channels in channels-last format. The pixels are taken by a pooling of one, because the gradient of a strided slice
    is never channels-last, and whatever adds to it then copies.
    """

    def __init__(self, in_channels: int, out_channels: int, stride: int) -> None:
        super().__init__()
        self.stride = stride
        self.conv1 = nn.Conv2d(in_channels, out_channels, 3, stride, 1, bias=False)
        self.norm1 = nn.BatchNorm2d(out_channels)
        self.conv2 = nn.Conv2d(out_channels, out_channels, 3, 1, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(out_channels)
        self.shortcut = nn.Sequential(nn.Conv2d(in_channels, out_channels, 1, bias=False), nn.BatchNorm2d(out_channels))

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.norm1(self.conv1(x)))
        return F.relu(self.norm2(self.conv2(y)) + self.shortcut(F.avg_pool2d(x, 1, self.stride)))


def convolutions(channels: int, widths: Sequence[int], stem_kernel: int) -> tuple[nn.Sequential, nn.Sequential]:
    """A stem over patches of ``channels`` numbers, and three residual stages that each halve both sides."""
    first, second, third = widths
    stem = nn.Sequential(
        nn.Conv2d(channels, first, stem_kernel, padding=stem_kernel // 2, bias=False), nn.BatchNorm2d(first), nn.ReLU()
    )
    stages = ResidualBlock(first, first, 2), ResidualBlock(first, second, 2), ResidualBlock(second, third, 2)
    return stem, nn.Sequential(*stages)


def check_convolutions(widths: Sequence[int], height: int, width: int, stem_kernel: int) -> None:
    """ValueError unless :func:`convolutions` of these sizes fit the frame."""
    at_least(1, stem_kernel=stem_kernel)
    if stem_kernel % 2 == 0:
        raise ValueError(f"stem_kernel = {stem_kernel} is even; take 1 or 3, so that the kernel has a middle.")
    if len(widths) != 3 or min(widths) < 1 or height % 32 or width % 32:
        raise ValueError(
            f"The encoder takes three widths of at least 1 and a frame whose sides are multiples of 32, not "
            f"{list(widths)} and {height} x {width}."
        )


class PatchEncoder(nn.Module):
    """What encoders share that see a stack of frames as normalised 4x4 patches: a subclass has ``embed``.

    Args:
        frame_stack: frames per embedding (kappa of the paper), oldest first.
        embedding_dim: d.
        height, width: of a frame in pixels, multiples of 4.
        grey: read the luma of every pixel instead of its three colours.
    """

    def __init__(self, frame_stack: int, embedding_dim: int, height: int, width: int, grey: bool) -> None:
        super().__init__()
        at_least(1, frame_stack=frame_stack, embedding_dim=embedding_dim)
        if height % PATCH or width % PATCH or min(height, width) < 1:
            raise ValueError(f"The encoder takes a frame whose sides are multiples of {PATCH}, not {height} x {width}.")
        self.frame_shape = (frame_stack, height, width, 3)
        self.frame_stack, self.height, self.width = frame_stack, height, width
        self.embedding_dim, self.grey = embedding_dim, grey
        mean, std = torch.tensor(PIXEL_MEAN), torch.tensor(PIXEL_STD)
        self.register_buffer("pixel_scale", (1 / (255 * std)).repeat(PATCH**2 * frame_stack), persistent=False)
        self.register_buffer("pixel_shift", (-mean / std).repeat(PATCH**2 * frame_stack), persistent=False)
        # what is seen of a normalised pixel; None where all three colours are
        self.register_buffer("color_mix", torch.tensor([LUMA]) if grey else None, persistent=False)
        if grey:
            self.register_buffer("grey_scale", torch.tensor(LUMA) / (255 * std), persistent=False)
            self.register_buffer("grey_shift", -(torch.tensor(LUMA) * mean / std).sum(), persistent=False)

    def normalize(self, frames: Tensor) -> Tensor:
        """uint8 frames [N, frame_stack, H, W, 3] to normalised patches [N, H / 4, W / 4, 16 * C * frame_stack], where
        C is 1 if ``grey``, else 3."""
        if self.grey:
            return patchify((frames.to(self.grey_scale.dtype) @ self.grey_scale + self.grey_shift)[..., None])
        # in place: at 64 observations the two buffers that this spares cost as much as a third of the network
        return patchify(frames).to(self.pixel_scale.dtype).mul_(self.pixel_scale).add_(self.pixel_shift)

    def forward(self, frames: Tensor) -> Tensor:
        """Embeds stacks of frames.

        Args:
            frames: uint8 [..., frame_stack, H, W, 3], oldest frame first.

        Returns:
            Embeddings [..., d] of unit length.

        Raises:
            ValueError: the dtype is not uint8 or the trailing shape is not the encoder's.
        """
        if frames.dtype != torch.uint8 or tuple(frames.shape[-4:]) != self.frame_shape:
            raise ValueError(
                f"The encoder takes uint8 frames of shape [..., {', '.join(map(str, self.frame_shape))}] "
                f"(frame_stack, H, W, 3), not {frames.dtype} {list(frames.shape)}; stack the frames oldest first."
            )
        embedding = self.embed(self.normalize(frames.reshape(-1, *self.frame_shape)))
        return embedding.reshape(*frames.shape[:-4], self.embedding_dim)


class Encoder(PatchEncoder):
    """Residual network with three stages, flattened (pooling loses the cart's position) and projected to ``d``.

    The stem rearranges the picture into 4x4 patches and runs a convolution over them; of 3x3 patches that is a 12x12
    kernel at stride 4. On a CPU it costs a fifth of a 7x7 stride-2 stem with pooling, and it reads position as well.

    Args:
        frame_stack: frames per embedding (kappa of the paper), stacked on channels, oldest first.
        widths: channels of the three stages; the paper prints 64, 128, 256.
        embedding_dim: d.
        height: frame height in pixels.
        width: frame width in pixels.
        grey: read the luma of every pixel instead of its three colours, which takes two thirds off the stem's work.
            For scenes in which nothing that matters is told by colour alone.
        stem_kernel: side of the stem's kernel in patches, odd. With 1 the first stage is the first to see two patches
            together, and the stem, the half of a small network's work, has a ninth of it.
    """

    def __init__(
        self,
        frame_stack: int = 2,
        widths: tuple[int, int, int] = (64, 128, 256),
        embedding_dim: int = 256,
        height: int = 64,
        width: int = 128,
        grey: bool = False,
        stem_kernel: int = 3,
    ) -> None:
        super().__init__(frame_stack, embedding_dim, height, width, grey)
        check_convolutions(widths, height, width, stem_kernel)
        self.widths, self.stem_kernel = tuple(widths), stem_kernel
        channels = (1 if grey else 3) * PATCH**2 * frame_stack
        self.stem, self.stages = convolutions(channels, self.widths, stem_kernel)
        self.project = nn.Linear(widths[-1] * (height // 32) * (width // 32), embedding_dim)
        self.to(memory_format=torch.channels_last)

    @property
    def memory_format(self) -> torch.memory_format:
        """Of the weights, and so of the pictures: ``encoder.to(memory_format=...)`` changes both, and no number."""
        is_last = self.stages[0].conv1.weight.is_contiguous(memory_format=torch.channels_last)
        return torch.channels_last if is_last else torch.contiguous_format

    def embed(self, patches: Tensor) -> Tensor:
        """Normalised patches [N, H / 4, W / 4, 16 * C * frame_stack] to embeddings [N, d] of unit length, float32."""
        picture = patches.permute(0, 3, 1, 2).contiguous(memory_format=self.memory_format)
        features = self.stages(self.stem(picture)).permute(0, 2, 3, 1).flatten(1)
        return F.normalize(self.project(features).float(), dim=-1)
