"""The augmentation of NeuBTF's training: a common rescale and crop, and disturbances of only the input.

Pictures are (B, C, H, W). Every random number comes from a generator on the CPU.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from neubtf.autoencoder import STRIDE

LEAST_BLUR = 1e-3  # σ in texels, which leaves a picture as it is


@dataclass(frozen=True)
class Crop:
    """A crop and a rescale that every picture of one step shares: `source` texels from `corner` on, become `size`."""

    corner: tuple[int, int]  # row, column
    source: tuple[int, int]  # rows, columns of the picture; beyond a border they continue at the opposite one
    size: tuple[int, int]
    around: tuple[int, int] = (0, 0)  # rows, columns on each side that are only surroundings
    whole: tuple[bool, bool] = (True, True)  # whether rows, columns are all of the picture's, so that they repeat

    @classmethod
    def drawn(
        cls, shape: tuple[int, int], largest: int, scale: float, periodic: bool, generator: torch.Generator, around: int
    ) -> "Crop":
        """A random window in pictures of a shape (H, W), rescaled by `scale`.

        The window has at most `largest` texels a side, in multiples of the autoencoder's stride if it can, and `around`
        more around them, because a cut side does not repeat: with 16 the root mean square difference of latents from
        those of the whole picture is 1e-4 of their deviation, with none 0.15. A side that would need all its texels is
        taken whole. The inner texels reach over the border only if the picture is periodic, the surroundings always.
        """
        places = torch.rand(2, generator=generator, dtype=torch.float64).tolist()
        sides = [_Side.drawn(*each, largest, scale, periodic, around) for each in zip(shape, places, strict=True)]
        return cls(*zip(*sides, strict=True))  # of each field both sides

    def inner(self) -> Tensor:
        """The texels (n,) of the window without its surroundings, as row · width + column of its size, row by row."""
        (height, width), (above, left) = self.size, self.around
        return torch.arange(height * width).view(height, width)[above : height - above, left : width - left].ravel()

    @property
    def inner_size(self) -> tuple[int, int]:
        """The size (rows, columns) of the window without its surroundings."""
        return self.size[0] - 2 * self.around[0], self.size[1] - 2 * self.around[1]

    def at_origin(self) -> "Crop":
        """The window without its place and its scale: equal for windows of one size."""
        return dataclasses.replace(self, corner=(0, 0), source=self.size)

    def aligned(self) -> "Crop":
        """The window with its corner moved to a corner of the autoencoder's cells."""
        row, col = (first // STRIDE * STRIDE for first in self.corner)
        return dataclasses.replace(self, corner=(row, col))

    def texels(self, shape: tuple[int, int]) -> Tensor:
        """The source's texels (n,) in a picture of a shape (H, W), as row · W + column, row by row."""
        axes = zip(self.corner, self.source, shape, strict=True)
        row, col = (torch.arange(first, first + count) % side for first, count, side in axes)
        return (row[:, None] * shape[1] + col).flatten()  # beyond a border, on at the opposite one

    def taps(self, texel: Tensor) -> tuple[Tensor, Tensor]:
        """The source texels (n, k) and weights (n, k) whose weighted mean gives some texels (n,) of the window."""
        places = (texel // self.size[1], texel % self.size[1])
        (row, high), (col, wide) = (_taps(*axis) for axis in zip(self.source, self.size, places, strict=True))
        index = row[:, :, None] * self.source[1] + col[:, None, :]  # (n, rows, columns)
        return index.flatten(1), (high[:, :, None] * wide[:, None, :]).flatten(1)

    @property
    def keeps_scale(self) -> bool:
        """Whether the window has a texel for each of the source."""
        return self.source == self.size

    def rescaled(self, pictures: Tensor) -> Tensor:
        """The source's pictures (B, C, *source) at the window's size: each texel is a mean of those it covers."""
        if self.keeps_scale:
            return pictures
        return functional.interpolate(pictures, self.size, mode="bilinear", antialias=True)


class _Side(NamedTuple):
    """One side of a window, with fields as in `Crop`."""

    corner: int
    source: int
    size: int
    around: int
    whole: bool

    @classmethod
    def drawn(cls, side: int, place: float, largest: int, scale: float, periodic: bool, around: int) -> "_Side":
        """One side of `Crop.drawn`, of a picture's `side` texels; `place`, from 0 to 1, chooses where it begins."""
        beyond = math.ceil(around / scale)
        size = _fitting(min(round(side * scale), largest))
        source = min(round(size / scale), side)
        # At its own scale a side that is not a multiple of the stride is cut: the autoencoder would pad it by more.
        if source < side <= source + 2 * beyond and (scale < 1 or side % STRIDE == 0):
            size, source = _fitting(round(side * scale)), side
        corner = int(place * (side if periodic else side - source + 1))
        if source == side:
            return cls(corner, source, size, around=0, whole=True)
        return cls((corner - beyond) % side, source + 2 * beyond, size + 2 * around, around, whole=False)


def draw_scale(smallest: float, keep: float, generator: torch.Generator) -> float:
    """A scale: 1 with probability `keep`, else uniform between `smallest` and 1."""
    chance, share = torch.rand(2, generator=generator, dtype=torch.float64).tolist()
    return 1.0 if chance < keep else smallest + (1 - smallest) * share


def taps_of(windows: Sequence[Crop], shape: tuple[int, int], device: torch.device) -> tuple[Tensor, Tensor]:
    """The texels and weights (windows, n, k) of a picture (H, W) whose weighted mean gives each window's n texels.

    The windows have one size, though not one source; a texel is row · W + column.
    """
    row, high = (taps.to(device, non_blocking=True) for taps in _axis_taps(windows, shape, 0))
    col, wide = (taps.to(device, non_blocking=True) for taps in _axis_taps(windows, shape, 1))
    texel = row[:, :, None, :, None] * shape[1] + col[:, None, :, None, :]  # (windows, h, w, rows, columns)
    weight = high[:, :, None, :, None] * wide[:, None, :, None, :]
    return texel.flatten(3).flatten(1, 2), weight.flatten(3).flatten(1, 2)


def _axis_taps(windows: Sequence[Crop], shape: tuple[int, int], axis: int) -> tuple[Tensor, Tensor]:
    """Rows, or columns, of a picture and their weights (windows, h or w, k); weights of 0 fill up to the most."""
    tables = [_rescale(window.source[axis], window.size[axis]) for window in windows]
    most = max(index.shape[1] for index, _ in tables)
    places, weights = list[Tensor](), list[Tensor]()
    for window, (index, weight) in zip(windows, tables, strict=True):
        filled = (0, most - index.shape[1])
        places.append(functional.pad((window.corner[axis] + index) % shape[axis], filled))
        weights.append(functional.pad(weight, filled))
    return torch.stack(places), torch.stack(weights)


def _taps(side: int, cut: int, place: Tensor) -> tuple[Tensor, Tensor]:
    """Source indices and weights (n, k) that a rescale from `side` to `cut` averages at each position (n,)."""
    index, weight = (each.to(place.device, non_blocking=True) for each in _rescale(side, cut))
    return index[place], weight[place]


@lru_cache(maxsize=1024)  # a fit draws the same few sizes again and again
def _rescale(side: int, cut: int) -> tuple[Tensor, Tensor]:
    """Source indices and weights (cut, k) that a rescale from `side` to `cut` averages at each position."""
    matrix = torch.eye(side)  # rescaled along its rows, it holds the weights (cut, side)
    if side != cut:
        matrix = functional.interpolate(matrix[None, None], (cut, side), mode="bilinear", antialias=True)[0, 0]
    weight, index = matrix.topk(int((matrix > 0).sum(1).max()))  # as many as any position needs
    return index, weight


def _fitting(side: int) -> int:
    """The largest multiple of the stride within a side, or the side if it is shorter than the stride."""
    return side // STRIDE * STRIDE or max(side, 1)


@dataclass(frozen=True)
class Disturbance:
    """Disturbances of only the input: random hue rotation, Gaussian blur, Gaussian noise."""

    hue: float = 1.0  # largest turn, in turns
    blur: float = 1.0  # largest σ in texels
    noise: float = 0.05  # largest σ, for pictures from 0 to 1

    def disturbed(self, pictures: Tensor, generator: torch.Generator) -> Tensor:
        """Pictures (B, 3, H, W) in [0, 1], each disturbed at random, within [0, 1]."""
        hue, blur, noise = torch.rand(3, len(pictures), generator=generator, dtype=torch.float64)  # (B,) each
        pictures = turned(pictures, self.hue * hue)
        if self.blur:
            pictures = blurred(pictures, self.blur * blur)
        grain = torch.randn(pictures.shape, generator=generator).to(pictures.device, non_blocking=True)
        strength = (self.noise * noise).to(pictures, non_blocking=True)
        return (pictures + strength[:, None, None, None] * grain).clamp(0, 1)


def turned(pictures: Tensor, turn: Tensor) -> Tensor:
    """Pictures (B, 3, H, W), the hue of each turned by shares (B,) of the wheel, clipped to [0, 1]; grey stays grey."""
    angle = 2 * math.pi * turn
    # Rodrigues' rotation around (1, 1, 1)/√3: cos + (1 − cos)/3 on the diagonal, (1 − cos)/3 ± sin/√3 beside it.
    third, side = (1 - angle.cos()) / 3, angle.sin() / math.sqrt(3)
    same, less, more = third + angle.cos(), third - side, third + side
    matrix = torch.stack([same, less, more, more, same, less, less, more, same], 1).view(-1, 3, 3)  # (B, 3, 3)
    return torch.einsum("bij,bjhw->bihw", matrix.to(pictures, non_blocking=True), pictures).clamp(0, 1)


def blurred(pictures: Tensor, sigma: Tensor) -> Tensor:
    """Periodic pictures (B, C, H, W), each after a Gaussian of its σ (B,) in texels, on the CPU, cut off at 3 σ."""
    radii = (3 * sigma).ceil()
    radius = int(radii.max())
    offsets = torch.arange(-radius, radius + 1)
    weights = (-0.5 * (offsets / sigma.clamp_min(LEAST_BLUR)[:, None]).square()).exp()  # (B, offsets)
    weights = weights * (offsets.abs() <= radii[:, None])
    total = weights.sum(1).to(pictures, non_blocking=True)[:, None, None, None]  # (B, 1, 1, 1)
    weights = weights.to(pictures, non_blocking=True)[:, :, None, None, None]  # (B, offsets, 1, 1, 1)
    for dim in (2, 3):
        summed = torch.zeros_like(pictures)
        for place, offset in enumerate(range(-radius, radius + 1)):
            summed = summed + pictures.roll(offset, dim) * weights[:, place]
        pictures = summed / total
    return pictures
