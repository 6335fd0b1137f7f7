"""The density of a scene's demand over the texels and pairs of a BTF: a fit draws samples by it and weights pairs with
it."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from bench.btf import periods

COVERED = 0.999  # share of the demand to cover; the rest may lie outside the kept pairs and levels of detail


class Drawn(NamedTuple):
    """Random samples: texel (n,) as row · W + column, and direction (n,).

    A direction index below the number of pairs is that pair; a larger one is a query, counted after the pairs.
    """

    texel: Tensor
    direction: Tensor


@dataclass(frozen=True)
class Density:
    """A demand over the pairs of one layout and a window of texels; the share `uniform` of it is spread evenly."""

    uv: Tensor  # (n, 2) within the window
    footprint: Tensor  # (n,) in units of the window's longer side
    wo: Tensor  # (n, 3)
    wi: Tensor  # (n, 3)
    cumulative: Tensor  # (n,) float64: running sums of the importance of the queries
    pair: Tensor  # (n, k) the pairs around each query
    weight: Tensor  # (n, k) their weights, including cosines
    per_pair: Tensor  # (N,) float64: the share of each pair in the demand
    uniform: float

    def to(self, device: torch.device) -> "Density":
        """The same, which tells the pairs around directions of a device; it still draws on the CPU."""
        return replace(self, pair=self.pair.to(device), weight=self.weight.to(device))

    @property
    def weights(self) -> Tensor:
        """The weight of each pair (N,), float32, 1 on average."""
        even = 1 / len(self.per_pair)
        mixed = self.uniform * even + (1 - self.uniform) * self.per_pair
        return (mixed / even).float()

    def levels(self, side: int) -> int:
        """The number of levels of detail, from the finest, that the demand uses of a texture of `side` texels."""
        coarsest = torch.quantile(self.footprint[:: max(1, len(self.footprint) // 100_000)], COVERED)
        return max(0, math.ceil(math.log2(max(1.0, float(coarsest) * side)))) + 1

    def draw(self, count: int, shape: tuple[int, int], generator: torch.Generator) -> Drawn:
        """`count` random samples of the window at a resolution.

        A texel is drawn at a random place in the footprint of a query, or within half a texel of its centre if that is
        larger, so that the four texels around it are drawn in the proportions of bilinear interpolation.
        """
        height, width = shape
        chance = torch.rand(count, 4, generator=generator, dtype=torch.float64)
        query = torch.searchsorted(self.cumulative, chance[:, 0] * self.cumulative[-1]).clamp_max(len(self.uv) - 1)
        side = self.footprint[query, None].clamp_min(1 / max(shape)) * torch.tensor(periods(shape))
        place = self.uv[query] + (chance[:, 1:3].float() - 0.5) * side
        col = (place[:, 0] * width).floor().long().remainder(width)
        row = ((1 - place[:, 1]) * height).floor().long().remainder(height)
        pairs = len(self.per_pair)
        anywhere = torch.randint(math.prod(shape) * pairs, (count,), generator=generator)
        texel, pair = anywhere.div(pairs, rounding_mode="floor"), anywhere.remainder(pairs)
        even = chance[:, 3] < self.uniform
        return Drawn(torch.where(even, texel, row * width + col), torch.where(even, pair, pairs + query))

    def around(self, direction: Tensor) -> tuple[Tensor, Tensor]:
        """The pairs that directions (n,), counted as in `Drawn`, are interpolated from, and their weights, both (n, k).

        Radiance is the sum of weight × radiance of the pair.
        """
        pairs, corners = len(self.per_pair), self.pair.shape[1]
        query, exact = (direction - pairs).clamp_min(0), (direction < pairs)[:, None]
        pair = torch.where(exact, direction[:, None], self.pair[query].long())
        return pair, torch.where(exact, 1 / corners, self.weight[query])
