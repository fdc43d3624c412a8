"""The paper's image augmentations, batched on the training device.

Brightness, contrast, saturation, hue, colour dropping and normalisation are all affine maps of a pixel's RGB triple, so
a random draw of all of them in random order is one 3x4 matrix per sample, applied by one batched product. What is lost
against doing them one by one is the clipping to [0, 255] in between, which these small strengths hardly ever reach.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from tsjepa.models.encoder import LUMA, PATCH, PIXEL_MEAN, PIXEL_STD, patchify, unpatchify
from tsjepa.support.parallel import rank_and_world_size

MID_GREY = 0.5  # contrast turns about it
RGB_TO_YIQ = ((0.299, 0.587, 0.114), (0.5959, -0.2746, -0.3213), (0.2115, -0.5227, 0.3112))


class Augmentation(nn.Module):
    """Random colour jitter, colour dropping, Gaussian blur and normalisation (paper, "Data Generation and Training").

    Args:
        brightness: factor drawn from 1 +- this.
        contrast: factor about mid-grey drawn from 1 +- this.
        saturation: factor about the luma drawn from 1 +- this.
        hue: rotation of the chroma plane, drawn from +- this many turns.
        grayscale: probability of replacing RGB by its luma.
        blur_sigma: range of the 5x5 Gaussian kernel's standard deviation in pixels, or None for no blur. The paper
            prints [0.1, 0.2], at which the neighbours weigh less than 4e-6: the identity, at a price in time.
    """

    def __init__(
        self,
        brightness: float = 0.05,
        contrast: float = 0.1,
        saturation: float = 0.1,
        hue: float = 0.05,
        grayscale: float = 0.05,
        blur_sigma: tuple[float, float] | None = None,
    ) -> None:
        super().__init__()
        self.brightness, self.contrast, self.saturation, self.hue = brightness, contrast, saturation, hue
        self.grayscale, self.blur_sigma = grayscale, blur_sigma
        yiq = torch.tensor(RGB_TO_YIQ)
        self.register_buffer("yiq", yiq, persistent=False)
        self.register_buffer("rgb", torch.linalg.inv(yiq), persistent=False)
        mean, std = torch.tensor(PIXEL_MEAN), torch.tensor(PIXEL_STD)
        self.register_buffer("mean", mean, persistent=False)
        self.register_buffer("std", std, persistent=False)
        self.register_buffer("eye", torch.eye(3), persistent=False)
        self.register_buffer("from_bytes", affine(torch.eye(3) / 255), persistent=False)
        # not expanded: data parallelism writes into buffers
        self.register_buffer("luma", torch.tensor(LUMA).repeat(3, 1), persistent=False)
        self.register_buffer("to_luma", affine(self.luma), persistent=False)
        self.register_buffer("normalize", affine(torch.diag(1 / std), (-mean / std).view(3, 1)), persistent=False)

    def forward(
        self, patches: Tensor, generator: torch.Generator, shared: int = 1, mix: Tensor | None = None
    ) -> Tensor:
        """Augments and normalises stacks of frames.

        Args:
            patches: uint8 [N, H / 4, W / 4, 48 * frame_stack], from :func:`patchify`.
            generator: source of the draws, on the CPU.
            shared: this many consecutive samples share one draw (a window of one trajectory keeps its colours).
            mix: [C, 3], ``Encoder.color_mix``: what is kept of the normalised colours; None for all three.

        Returns:
            Patches [N, H / 4, W / 4, 16 * C * frame_stack] for ``Encoder.embed``; in the autocast dtype, else float32.
        """
        groups, device = len(patches) // shared, patches.device
        rank, world_size = rank_and_world_size()  # under data parallelism, this process's share of the batch's draws
        draws = self.draw(groups * world_size, generator)[rank::world_size].to(device)
        if mix is not None:
            draws = mix @ draws
        colors = draws.shape[1]
        dtype = torch.get_autocast_dtype(device.type) if torch.is_autocast_enabled(device.type) else torch.float32
        if self.blur_sigma is not None:
            patches = patchify(self.blur(unpatchify(patches), generator, shared))
        # one colour map for the 16 pixels of a patch: a block-diagonal product of 48 rows keeps the matrix units busy
        matrix = torch.zeros(groups, PATCH**2, 3, PATCH**2, colors, dtype=dtype, device=device)
        matrix.diagonal(dim1=1, dim2=3).copy_(draws[:, :, :3].transpose(1, 2)[..., None])
        offset = draws[:, None, None, :, 3].expand(-1, 1, PATCH**2, -1).reshape(groups, 1, -1).to(dtype)
        rows = patches.view(groups, -1, 3 * PATCH**2).to(dtype)
        mapped = torch.baddbmm(offset, rows, matrix.view(groups, 3 * PATCH**2, -1))
        return mapped.view(*patches.shape[:3], -1)

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """Random affine colour maps [count, 3, 4] from 0..255 RGB to normalised RGB."""
        uniform = torch.rand(count, 6, generator=generator).to(self.yiq.device)
        order = torch.rand(count, 4, generator=generator).argsort(dim=1).to(self.yiq.device)
        signed = 2 * uniform - 1
        eye = self.eye
        column = lambda values: values.view(-1, 1, 1)  # noqa: E731
        bright = column(1 + self.brightness * signed[:, 0]) * eye
        contrast = column(1 + self.contrast * signed[:, 1])
        saturation = column(1 + self.saturation * signed[:, 2])
        angle = 2 * math.pi * self.hue * signed[:, 3]
        turn = torch.zeros(count, 3, 3, device=angle.device)
        turn[:, 0, 0] = 1
        turn[:, 1, 1] = turn[:, 2, 2] = angle.cos()
        turn[:, 1, 2], turn[:, 2, 1] = -angle.sin(), angle.sin()
        linear = (bright, contrast * eye, saturation * eye + (1 - saturation) * self.luma, self.rgb @ turn @ self.yiq)
        maps = affine(torch.stack(linear, dim=1))
        maps[:, 1, :3, 3] = ((1 - contrast) * MID_GREY)[..., 0]
        maps = maps.gather(1, order.view(-1, 4, 1, 1).expand(-1, -1, 4, 4))
        colour = maps[:, 3] @ maps[:, 2] @ maps[:, 1] @ maps[:, 0]
        colour = torch.where(column(uniform[:, 4] < self.grayscale), self.to_luma @ colour, colour)
        return (self.normalize @ colour @ self.from_bytes)[:, :3]

    def blur(self, frames: Tensor, generator: torch.Generator, shared: int = 1) -> Tensor:
        """5x5 Gaussian blur of frames [N, frame_stack, H, W, 3], one standard deviation per sample; returns float32.

        ``shared`` consecutive samples are one window, of which data parallelism gives each process its share.
        """
        low, high = self.blur_sigma
        rank, world_size = rank_and_world_size()
        uniform = torch.rand(len(frames) // shared * world_size, shared, generator=generator)[rank::world_size]
        sigma = low + (high - low) * uniform.reshape(-1, 1).to(frames.device)
        weight = torch.exp(-(torch.arange(-2, 3, device=frames.device) ** 2) / (2 * sigma**2))
        weight = weight / weight.sum(1, keepdim=True)
        planes = frames.movedim(4, 2).float()
        _, stack, colors, height, width = planes.shape
        kernel = (weight[:, :, None] * weight[:, None, :]).repeat_interleave(stack * colors, 0)[:, None]
        padded = F.pad(planes.reshape(1, -1, height, width), (2, 2, 2, 2), mode="reflect")
        return F.conv2d(padded, kernel, groups=len(kernel)).view(planes.shape).movedim(2, 4)


def affine(linear: Tensor, offset: Tensor | None = None) -> Tensor:
    """Homogeneous 4x4 matrix of the colour map x -> ``linear`` [..., 3, 3] x + ``offset`` [..., 3, 1]."""
    matrix = torch.zeros(*linear.shape[:-2], 4, 4, device=linear.device)
    matrix[..., :3, :3] = linear
    matrix[..., 3, 3] = 1
    if offset is not None:
        matrix[..., :3, 3:] = offset
    return matrix
