"""The augmentation of NeuBTF's training: a common rescale and crop, and disturbances of only the input.

The input of a step is the picture that the encoder sees. Pictures are (B, C, H, W). Every random number comes from a
generator on the CPU.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from bench.metrics.display import LUMA
from bench.training import FromHost, on_host
from neubtf.autoencoder import STRIDE

LEAST_BLUR = 1e-3  # σ in texels, which leaves a picture as it is


@dataclass(frozen=True)
class Crop:
    """A crop and a rescale that all pictures of one step share: the `source` texels from `corner` on become `size`."""

    corner: tuple[int, int]  # row, column
    source: tuple[int, int]  # rows, columns of the picture; beyond a border they continue at the opposite one
    size: tuple[int, int]  # rows, columns of the window
    around: tuple[int, int] = (0, 0)  # rows, columns on each side that are only surroundings
    whole: tuple[bool, bool] = (True, True)  # whether rows, columns are all of the picture's, so that they repeat

    @classmethod
    def drawn(
        cls, shape: tuple[int, int], largest: int, scale: float, periodic: bool, generator: torch.Generator, around: int
    ) -> "Crop":
        """A random window in pictures of a shape (H, W), rescaled by `scale`.

        Without its surroundings the window has at most `largest` texels a side, in multiples of the autoencoder's
        stride if it can. `around` more lie on each side, because a cut side does not repeat: with 16 the root mean
        square difference of latents from those of the whole picture is 1e-4 of their deviation, with none 0.15. A side
        that would then need all its texels is taken whole, so it may exceed `largest`. The inner texels reach over the
        border only if the picture is periodic, the surroundings always.
        """
        row_place, col_place = torch.rand(2, generator=generator, dtype=torch.float64).tolist()
        rows = _Side.drawn(shape[0], row_place, largest, scale, periodic, around)
        cols = _Side.drawn(shape[1], col_place, largest, scale, periodic, around)
        return cls(
            corner=(rows.corner, cols.corner),
            source=(rows.source, cols.source),
            size=(rows.size, cols.size),
            around=(rows.around, cols.around),
            whole=(rows.whole, cols.whole),
        )

    def inner(self, device: torch.device) -> Tensor:
        """The texels (n,) of the window without its surroundings, as row · width + column of its size, row by row."""
        (height, width), (above, left) = self.size, self.around
        texels = torch.arange(height * width, device=device).view(height, width)
        return texels[above : height - above, left : width - left].ravel()

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
        return self.moved(row, col)

    def moved(self, row: int, col: int) -> "Crop":
        """The window with its corner moved to a place."""
        return dataclasses.replace(self, corner=(row, col))

    def texels(self, shape: tuple[int, int]) -> Tensor:
        """The source's texels (n,) in a picture of a shape (H, W), as row · W + column, row by row."""
        (first_row, first_col), (rows, cols) = self.corner, self.source
        # Beyond a border the source continues at the opposite one.
        row = torch.arange(first_row, first_row + rows) % shape[0]
        col = torch.arange(first_col, first_col + cols) % shape[1]
        return (row[:, None] * shape[1] + col).flatten()

    def taps(self, texel: Tensor) -> tuple[Tensor, Tensor]:
        """The source's texels, as row · its columns + column, and weights, (n, k) each, whose weighted mean gives some
        texels (n,) of the window."""
        row, row_weight = _taps(self.source[0], self.size[0], texel // self.size[1])
        col, col_weight = _taps(self.source[1], self.size[1], texel % self.size[1])
        index = row[:, :, None] * self.source[1] + col[:, None, :]  # (n, rows, columns)
        weight = row_weight[:, :, None] * col_weight[:, None, :]
        return index.flatten(1), weight.flatten(1)

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
        """One side of `Crop.drawn`, of a picture's `side` texels; `place`, from 0 to 1, chooses where it begins.

        Without the surroundings, `source` texels become `size`; `beyond` more on each end become `around`.
        """
        beyond = math.ceil(around / scale)
        size = _fitting(min(round(side * scale), largest))
        source = min(round(size / scale), side)
        needs_all_texels = source < side <= source + 2 * beyond
        # At its own scale a side that is not a multiple of the stride is cut: the autoencoder would pad it by more.
        if needs_all_texels and (scale < 1 or side % STRIDE == 0):
            size, source = _fitting(round(side * scale)), side
        corners = side if periodic else side - source + 1  # at how many texels the inner window may begin
        corner = int(place * corners)
        if source == side:
            return cls(corner, source, size, around=0, whole=True)
        return cls((corner - beyond) % side, source + 2 * beyond, size + 2 * around, around, whole=False)


def draw_scale(smallest: float, keep: float, generator: torch.Generator) -> float:
    """A scale: 1 with probability `keep`, else uniform between `smallest` and 1."""
    # Both numbers are always drawn, so that later draws do not depend on the choice.
    chance, share = torch.rand(2, generator=generator, dtype=torch.float64).tolist()
    if chance < keep:
        return 1.0
    return smallest + (1 - smallest) * share


def taps_of(windows: Sequence[Crop], shape: tuple[int, int], device: torch.device) -> tuple[Tensor, Tensor]:
    """The texels and weights (windows, n, k) of a picture (H, W) whose weighted mean gives each window's n texels.

    The windows have one size, though not one source; a texel is row · W + column.
    """
    row, row_weight = _axis_taps(windows, shape, 0, device)
    col, col_weight = _axis_taps(windows, shape, 1, device)
    texel = row[:, :, None, :, None] * shape[1] + col[:, None, :, None, :]  # (windows, h, w, rows, columns)
    weight = row_weight[:, :, None, :, None] * col_weight[:, None, :, None, :]
    return texel.flatten(3).flatten(1, 2), weight.flatten(3).flatten(1, 2)


def _axis_taps(
    windows: Sequence[Crop], shape: tuple[int, int], axis: int, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Along an axis, the places in a picture and their weights, (windows, side, k), that give each window's texels.

    A window that needs fewer places than k is filled up with weights of 0.
    """
    tables = [_rescale(window.source[axis], window.size[axis], torch.device("cpu")) for window in windows]
    most = max(index.shape[1] for index, _ in tables)
    places, weights = list[Tensor](), list[Tensor]()
    for window, (index, weight) in zip(windows, tables, strict=True):
        padding = (0, most - index.shape[1])  # behind the last column
        places.append(functional.pad((window.corner[axis] + index) % shape[axis], padding))
        weights.append(functional.pad(weight, padding))
    return torch.stack(places).to(device, non_blocking=True), torch.stack(weights).to(device, non_blocking=True)


def _taps(source: int, size: int, place: Tensor) -> tuple[Tensor, Tensor]:
    """As `_rescale`, but only of some places (n,) of the rescaled side: (n, k)."""
    index, weight = _rescale(source, size, place.device)
    return index[place], weight[place]


@lru_cache(maxsize=1024)  # a fit draws the same few sizes again and again
def _rescale(source: int, size: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """The source's texels and their weights, (size, k), that a rescale of a side from `source` to `size` averages.

    For `source = 4` and `size = 2` row 0 has the texels 0, 1 and 2, and what each of them contributes to texel 0.
    """
    matrix = torch.eye(source)  # rescaled along its rows, it holds the weights (size, source)
    if source != size:
        matrix = functional.interpolate(matrix[None, None], (size, source), mode="bilinear", antialias=True)[0, 0]
    most = int((matrix > 0).sum(1).max())  # texels that any row needs; others have further ones of weight 0
    weight, index = matrix.topk(most)
    return index.to(device, non_blocking=True), weight.to(device, non_blocking=True)


def _fitting(side: int) -> int:
    """The largest multiple of the stride within a side, or the side, at least 1, if it is shorter than the stride."""
    if side < STRIDE:
        return max(side, 1)
    return side // STRIDE * STRIDE


@dataclass(frozen=True)
class Disturbance:
    """Disturbances of only the input: random hue rotation and saturation, Gaussian blur, Gaussian noise."""

    hue: float = 1.0  # largest turn, in turns
    saturation: float = 1.0  # s: the distance from grey is multiplied by 1 − s to 1 + s
    blur: float = 1.0  # largest σ in texels
    noise: float = 0.05  # largest σ, for pictures from 0 to 1

    def disturbed(self, pictures: Tensor, generator: torch.Generator) -> Tensor:
        """Pictures (B, 3, H, W) in [0, 1], each disturbed at random, within [0, 1]."""

        def drawn(progress: float) -> FromHost:
            """The weights of the blur and their sums, and the strength and the numbers of the noise."""
            blur, noise = torch.rand(2, len(pictures), generator=generator, dtype=torch.float64)  # (B,) each
            weights, total = gaussians(self.blur * blur)
            grain = torch.randn(pictures.shape, generator=generator)
            precise = [weights, total, self.noise * noise]
            return FromHost([*(values.to(pictures.dtype) for values in precise), grain], plan=weights.shape)

        pictures = self.recoloured(pictures, generator)
        weights, total, strength, grain = on_host(drawn, 0.0, pictures.device).tensors
        if self.blur:
            pictures = blurred(pictures, weights, total)
        return (pictures + strength[:, None, None, None] * grain).clamp(0, 1)

    def recoloured(self, pictures: Tensor, generator: torch.Generator) -> Tensor:
        """Pictures (B, 3, H, W) in [0, 1], each at random in other colours, within [0, 1]."""

        def drawn(progress: float) -> FromHost:
            """The matrices of hue, and the factors of saturation."""
            hue, saturation = torch.rand(2, len(pictures), generator=generator, dtype=torch.float64)  # (B,) each
            factor = 1 + self.saturation * (2 * saturation - 1)
            precise = [rotation(self.hue * hue), factor]
            return FromHost([values.to(pictures.dtype) for values in precise], plan=())

        matrix, factor = on_host(drawn, 0.0, pictures.device).tensors
        return saturated(turned(pictures, matrix), factor)


def saturated(pictures: Tensor, factor: Tensor) -> Tensor:
    """Pictures (B, 3, H, W), the distance of each from its grey times factors (B,), clipped to [0, 1]; 0 gives grey."""
    grey = torch.einsum("c,bchw->bhw", _luminance(pictures.device), pictures)[:, None]
    return (grey + factor[:, None, None, None] * (pictures - grey)).clamp(0, 1)


@cache
def _luminance(device: torch.device) -> Tensor:
    """The weights (3,) of linear red, green and blue in their luminance."""
    return torch.from_numpy(LUMA).float().to(device, non_blocking=True)


def rotation(turn: Tensor) -> Tensor:
    """Matrices (B, 3, 3) that turn the hue of colours by shares (B,) of the wheel."""
    angle = 2 * math.pi * turn
    # Rodrigues' rotation around (1, 1, 1)/√3: cos + (1 − cos)/3 on the diagonal, (1 − cos)/3 ± sin/√3 beside it.
    third = (1 - angle.cos()) / 3
    sine_part = angle.sin() / math.sqrt(3)
    diagonal, less, more = third + angle.cos(), third - sine_part, third + sine_part
    entries = [diagonal, less, more, more, diagonal, less, less, more, diagonal]  # row by row
    return torch.stack(entries, 1).view(-1, 3, 3)


def turned(pictures: Tensor, matrix: Tensor) -> Tensor:
    """Pictures (B, 3, H, W), the hue of each turned by its `rotation` (B, 3, 3), clipped to [0, 1]; grey stays grey."""
    return torch.einsum("bij,bjhw->bihw", matrix, pictures).clamp(0, 1)


def gaussians(sigma: Tensor) -> tuple[Tensor, Tensor]:
    """The weights (B, offsets) of Gaussians of σ (B,) in texels, each cut off at its 3 σ, and the sums (B,) of them."""
    radii = (3 * sigma).ceil()  # (B,)
    radius = int(radii.max())
    offsets = torch.arange(-radius, radius + 1)
    weights = (-0.5 * (offsets / sigma.clamp_min(LEAST_BLUR)[:, None]).square()).exp()
    weights = weights * (offsets.abs() <= radii[:, None])  # each picture is cut off at its own radius
    return weights, weights.sum(1)


def blurred(pictures: Tensor, weights: Tensor, total: Tensor) -> Tensor:
    """Periodic pictures (B, C, H, W), each convolved with its Gaussian: weights (B, offsets) and their `total` (B,), as
    of `gaussians`."""
    weights, total = weights[:, :, None, None, None], total[:, None, None, None]
    radius = weights.shape[1] // 2
    for dim in (2, 3):
        weighted_sum = torch.zeros_like(pictures)
        for i, offset in enumerate(range(-radius, radius + 1)):
            weighted_sum = weighted_sum + pictures.roll(offset, dim) * weights[:, i]
        pictures = weighted_sum / total
    return pictures
