"""Where a demand lies among the texels and pairs of a BTF: what a fit draws its samples by, and weighs its pairs with."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from bench.btf import Layout
from bench.demand.corners import corners, share_of
from bench.demand.demand import Demand
from bench.demand.need import Window


@dataclass(frozen=True)
class Density:
    """A demand over the pairs of one layout and a window of texels; a share `uniform` is spread over all evenly."""

    uv: Tensor  # (n, 2) within the window
    footprint: Tensor  # (n,) in units of the window
    cumulative: Tensor  # (n,) float64: running sums of the importance of the queries
    pair: Tensor  # (n, k) the pairs around each query …
    pair_cumulative: Tensor  # … and running sums of their shares
    per_pair: Tensor  # (N,) float64: the demand on each pair
    uniform: float

    @classmethod
    def of(cls, demand: Demand, layout: Layout, window: Window, uniform: float) -> "Density":
        """The density of a demand over the pairs of a BTF cut to a window."""
        found, importance = corners(layout, demand), demand.importance
        shares = found.weight.double().cumsum(1)
        return cls(
            window.within(torch.from_numpy(demand.uv).double()).float(),
            torch.from_numpy(demand.footprint) * window.stretch,
            torch.from_numpy(importance).cumsum(0),
            found.sample,
            (shares / shares[:, -1:]).float(),
            torch.from_numpy(share_of(found, importance, len(layout.view))),
            uniform,
        )

    @property
    def weights(self) -> Tensor:
        """How much each pair counts (N,), float32, 1 on average."""
        even = 1 / len(self.per_pair)
        mixed = self.uniform * even + (1 - self.uniform) * self.per_pair
        return (mixed / even).float()

    def draw(self, count: int, shape: tuple[int, int], generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """`count` random texels (row · W + column) of the window at a resolution, and pairs.

        A texel is the one at a random place in the footprint of a query, or within half a texel of its middle, which
        finds the four around it in the proportions of bilinear interpolation; a pair is one of those around its
        directions, in the proportions of theirs.
        """
        height, width = shape
        chance = torch.rand(count, 5, generator=generator, dtype=torch.float64)
        query = torch.searchsorted(self.cumulative, chance[:, 0] * self.cumulative[-1]).clamp_max(len(self.uv) - 1)
        side = self.footprint[query, None].clamp_min(1 / max(shape))
        place = self.uv[query] + (chance[:, 1:3].float() - 0.5) * side
        col = (place[:, 0] * width).floor().long().remainder(width)
        row = ((1 - place[:, 1]) * height).floor().long().remainder(height)
        after = (self.pair_cumulative[query] < chance[:, 3:4]).sum(1, keepdim=True)
        pair = self.pair[query].gather(1, after.clamp_max(self.pair.shape[1] - 1))[:, 0].long()
        texel = row * width + col
        anywhere = torch.randint(math.prod(shape) * len(self.per_pair), (count,), generator=generator)
        even = chance[:, 4] < self.uniform
        texel = torch.where(even, anywhere.div(len(self.per_pair), rounding_mode="floor"), texel)
        return texel, torch.where(even, anywhere.remainder(len(self.per_pair)), pair)
