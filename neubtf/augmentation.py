"""What NeuBTF's training does to its pictures: a common rescale and crop, and what the input alone suffers.

Pictures are (B, C, H, W). Every random number comes from a generator on the CPU.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from neubtf.autoencoder import STRIDE


@dataclass(frozen=True)
class Window:
    """A rescale and a crop that every picture of one step shares."""

    scaled: tuple[int, int]  # H, W of the rescaled picture
    corner: tuple[int, int]  # row, column of the crop in it
    size: tuple[int, int]  # of the crop
    periodic: bool

    @classmethod
    def drawn(
        cls, shape: tuple[int, int], largest: int, smallest: float, periodic: bool, generator: torch.Generator
    ) -> "Window":
        """A random window of pictures of a shape (H, W).

        Half of all windows keep the scale, the others draw it between `smallest` and 1, uniformly. A crop has at most
        `largest` texels a side, in multiples of the autoencoder's stride where the picture has as many; a periodic
        picture is cut anywhere.
        """
        keep, share = _uniform(2, generator)
        scale = 1.0 if keep < 0.5 else smallest + (1 - smallest) * share
        scaled = tuple(max(1, round(side * scale)) for side in shape)
        size = tuple(_fitting(min(side, largest)) for side in scaled)
        ends = [side if periodic else side - cut + 1 for side, cut in zip(scaled, size, strict=True)]
        corner = tuple(int(share * end) for share, end in zip(_uniform(2, generator), ends, strict=True))
        return cls((scaled[0], scaled[1]), (corner[0], corner[1]), (size[0], size[1]), periodic)

    def of(self, pictures: Tensor) -> Tensor:
        """What is seen of some pictures: a down-scaled texel is a weighted mean of those that it covers."""
        if tuple(pictures.shape[2:]) != self.scaled:
            pictures = functional.interpolate(pictures, self.scaled, mode="bilinear", antialias=True)
        for dim, first, count in zip((2, 3), self.corner, self.size, strict=True):
            there = torch.arange(first, first + count, device=pictures.device) % pictures.shape[dim]
            pictures = pictures.index_select(dim, there)
        return pictures


def _fitting(side: int) -> int:
    return max(side // STRIDE * STRIDE, min(side, STRIDE))


@dataclass(frozen=True)
class Disturbance:
    """What the input alone suffers: a turn of its hue anywhere on the wheel, Gaussian blur, Gaussian noise."""

    hue: float = 1.0  # largest turn, in turns
    blur: float = 1.0  # largest σ in texels
    noise: float = 0.05  # largest σ, where pictures reach from 0 to 1

    def of(self, pictures: Tensor, generator: torch.Generator) -> Tensor:
        """Pictures (B, 3, H, W) in [0, 1], disturbed at random, within [0, 1]."""
        hue, blur, noise = _uniform(3, generator)
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


def _uniform(count: int, generator: torch.Generator) -> list[float]:
    return torch.rand(count, generator=generator, dtype=torch.float64).tolist()
