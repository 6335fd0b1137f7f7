"""What NeuBTF's training does to its pictures: a common rescale and crop, and what the input alone suffers.

Pictures are (B, C, H, W). Every random number comes from a generator on the CPU.
"""

import dataclasses
import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from neubtf.autoencoder import STRIDE


@dataclass(frozen=True)
class Window:
    """A crop and a rescale that every picture of one step shares: `source` texels from `corner` on, become `size`."""

    corner: tuple[int, int]  # row, column
    source: tuple[int, int]  # rows, columns of the picture; those beyond its border are those of the other one
    size: tuple[int, int]

    @classmethod
    def drawn(
        cls, shape: tuple[int, int], largest: int, smallest: float, periodic: bool, generator: torch.Generator
    ) -> "Window":
        """A random window of pictures of a shape (H, W).

        Half of all windows keep the scale, the others draw it uniformly between `smallest` and 1. At most `largest`
        texels a side come out, in multiples of the autoencoder's stride where there are as many. Only of a periodic
        picture does a window reach over the border.
        """
        keep, share, *places = torch.rand(4, generator=generator, dtype=torch.float64).tolist()
        scale = 1.0 if keep < 0.5 else smallest + (1 - smallest) * share
        size = tuple(_fitting(min(round(side * scale), largest)) for side in shape)
        source = tuple(min(round(cut / scale), side) for cut, side in zip(size, shape, strict=True))
        ends = [side if periodic else side - cut + 1 for cut, side in zip(source, shape, strict=True)]
        corner = tuple(int(place * end) for place, end in zip(places, ends, strict=True))
        return cls((corner[0], corner[1]), (source[0], source[1]), (size[0], size[1]))

    def aligned(self) -> "Window":
        """The window with its corner moved to a corner of the autoencoder's cells."""
        row, col = (first // STRIDE * STRIDE for first in self.corner)
        return dataclasses.replace(self, corner=(row, col))

    def texels(self, shape: tuple[int, int]) -> Tensor:
        """The source's texels (n,) in a picture of a shape (H, W), as row · W + column, row by row."""
        row, col = (
            torch.arange(first, first + count) % side
            for first, count, side in zip(self.corner, self.source, shape, strict=True)
        )
        return (row[:, None] * shape[1] + col).flatten()

    def taps(self, texel: Tensor) -> tuple[Tensor, Tensor]:
        """The weighted mean that some texels (n,) of the window are: texels (n, k) of its source, weights (n, k)."""
        axes = [
            _taps(side, cut, place)
            for side, cut, place in zip(
                self.source, self.size, (texel // self.size[1], texel % self.size[1]), strict=True
            )
        ]
        (row, high), (col, wide) = axes
        index = row[:, :, None] * self.source[1] + col[:, None, :]
        return index.flatten(1), (high[:, :, None] * wide[:, None, :]).flatten(1)

    @property
    def keeps_scale(self) -> bool:
        return self.source == self.size

    def rescaled(self, pictures: Tensor) -> Tensor:
        """The source's pictures (B, C, *source) at the window's size: a texel is a weighted mean of those it covers."""
        return (
            pictures
            if self.keeps_scale
            else functional.interpolate(pictures, self.size, mode="bilinear", antialias=True)
        )


def _taps(side: int, cut: int, place: Tensor) -> tuple[Tensor, Tensor]:
    """Of places (n,) on an axis: those of its `side` that a rescale to `cut` averages, and weights, both (n, k)."""
    matrix = torch.eye(side)
    if side != cut:
        matrix = functional.interpolate(matrix[None, None], (cut, side), mode="bilinear", antialias=True)[0, 0]
    weight, index = matrix.topk(int((matrix > 0).sum(1).max()))
    return index.to(place.device)[place], weight.to(place.device)[place]


def _fitting(side: int) -> int:
    """The largest multiple of the stride within a side, or the side where it is shorter than that."""
    return side // STRIDE * STRIDE or max(side, 1)


@dataclass(frozen=True)
class Disturbance:
    """What the input alone suffers: a turn of its hue anywhere on the wheel, Gaussian blur, Gaussian noise."""

    hue: float = 1.0  # largest turn, in turns
    blur: float = 1.0  # largest σ in texels
    noise: float = 0.05  # largest σ, where pictures reach from 0 to 1

    def of(self, pictures: Tensor, generator: torch.Generator) -> Tensor:
        """Pictures (B, 3, H, W) in [0, 1], disturbed at random, within [0, 1]."""
        hue, blur, noise = torch.rand(3, generator=generator, dtype=torch.float64).tolist()
        pictures = turned(pictures, self.hue * hue)
        pictures = blurred(pictures, self.blur * blur)
        grain = torch.randn(pictures.shape, generator=generator).to(pictures.device)
        return (pictures + self.noise * noise * grain).clamp(0, 1)


def turned(pictures: Tensor, turn: float) -> Tensor:
    """Pictures (B, 3, H, W) with their hue turned by a share of the wheel, around the grey axis: grey stays grey.

    A third of a turn makes red green, green blue, and blue red. The mean of the channels stays; what leaves [0, 1] is
    clipped.
    """
    angle = 2 * math.pi * turn
    # Rodrigues' rotation around (1, 1, 1)/√3: cos + (1 − cos)/3 on the diagonal, (1 − cos)/3 ± sin/√3 beside it.
    same, less, more = (
        (1 - math.cos(angle)) / 3 + part
        for part in (math.cos(angle), -math.sin(angle) / math.sqrt(3), math.sin(angle) / math.sqrt(3))
    )
    matrix = pictures.new_tensor([[same, less, more], [more, same, less], [less, more, same]])
    return torch.einsum("ij,bjhw->bihw", matrix, pictures).clamp(0, 1)


def blurred(pictures: Tensor, sigma: float) -> Tensor:
    """Periodic pictures (B, C, H, W) after a Gaussian of σ in texels."""
    if sigma < 1e-3:
        return pictures
    radius = math.ceil(3 * sigma)
    offsets = range(-radius, radius + 1)
    weights = [math.exp(-0.5 * (offset / sigma) ** 2) for offset in offsets]
    for dim in (2, 3):
        shifted = (pictures.roll(offset, dim) * weight for offset, weight in zip(offsets, weights, strict=True))
        pictures = sum(shifted, torch.zeros_like(pictures)) / sum(weights)
    return pictures
