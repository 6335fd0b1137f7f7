"""Finds the part of a BTF that a demand needs: a window of texels, no finer than visible, and the nearby pairs.

Finds the pairs around each query of a demand, too, and the share of the demand on each pair. Pairs are those of the
BTF. A query's share of the demand is its `Demand.importance`.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.ndimage import binary_dilation

from bench.btf import BTF, Array, Layout, periods
from bench.codec import COVERED
from bench.codecs.window import CELLS, Window, cell_of, to_hex
from bench.demand.demand import Demand
from bench.directions.interpolation import Hemisphere, PairInterpolator, Weights

FINEST = 0.01  # the share of the demand that may be finer than the stored texels
CHUNK = 8_192  # queries at once, because a search among scattered pairs computes all distances


@dataclass(frozen=True)
class NeededPart:
    """The needed part of a BTF. `views` and `lights` are maps (CELLS, CELLS) of the demand's directions."""

    window: Window
    pairs: Array  # indices of the BTF's pairs
    finest: float  # footprint, in longer sides of the texture; only `FINEST` of the demand is finer
    views: Array
    lights: Array

    @classmethod
    def for_demand(cls, btf: BTF, demand: Demand, every_pair: bool = False) -> "NeededPart":
        """The part of a BTF that a demand needs; `every_pair` keeps all pairs."""
        finest = _finest_footprint(demand)
        # Texels a side of a box that this footprint still covers: whole ones, at most the shorter side of the picture.
        factor = max(1, min(int(finest * max(btf.shape)), *btf.shape))
        window = _window(btf.shape, demand, factor)
        pairs = np.arange(len(btf)) if every_pair else needed_pairs(btf.layout, demand)
        return cls(window, pairs, finest, _cells_around(demand.wo), _cells_around(demand.wi))

    def cut(self, btf: BTF) -> BTF:
        """Cut the BTF to the needed part."""
        if len(self.pairs) < len(btf):
            btf = btf.subset(self.pairs)
        return self.window.cut(btf)

    def facts(self, demand: Demand) -> dict[str, Any]:
        """The facts that a codec file records."""
        window = self.window
        return {
            "name": demand.name,
            "demand": demand.fingerprint,
            "size": list(window.size),
            "window": [window.top, window.left, window.height, window.width],
            "factor": window.factor,
            "pairs": len(self.pairs),
            "finest": self.finest,
            "views": to_hex(self.views),
            "lights": to_hex(self.lights),
        }


def _finest_footprint(demand: Demand) -> float:
    """The footprint of which only the share `FINEST` of a demand is finer, in longer sides of the texture."""
    order = np.argsort(demand.footprint, kind="stable")
    # From the finest query on: the first with which the running share of the demand reaches `FINEST`. Rounding may keep
    # the sum below it, so the last query is the limit.
    running = np.cumsum(demand.importance[order])
    place = min(int(np.searchsorted(running, FINEST)), len(order) - 1)
    return float(demand.footprint[order[place]])


def needed_pairs(layout: Layout, demand: Demand) -> Array:
    """Sorted indices of the pairs around a demand; for a product of directions, pairs that form a smaller product."""
    share = pair_shares(layout, demand)
    if layout.grid is None:
        return np.sort(_heaviest(share))
    views = _needed_directions(layout.views, np.bincount(layout.view, share, len(layout.views)))
    lights = _needed_directions(layout.lights, np.bincount(layout.light, share, len(layout.lights)))
    return np.sort(layout.grid[np.ix_(views, lights)].ravel())


def _needed_directions(directions: Array, share: Array) -> Array:
    """Indices of the fewest directions (n, 3), all views or all lights, that hold the demand by their shares (n,), and
    of those needed to interpolate between them. A triangle between kept directions is a triangle of the whole set, so
    answers inside it stay the same."""
    middle = share @ directions  # (3,): the mean direction of the demand
    # By share, the largest first, and of equal shares the nearest to the middle (the last key counts first).
    order = np.lexsort((-(directions @ middle), -share))
    count = len(_heaviest(share))
    # Further ones follow until answers can be interpolated. A flat set has no triangles to interpolate in: too few
    # directions, or all on one line.
    while count < len(directions) and Hemisphere(directions[order[:count]]).flat:
        count += 1
    return np.sort(order[:count])


def _heaviest(share: Array) -> Array:
    """The fewest indices whose shares, of all shares (n,), come to `COVERED` of their sum; the largest share first."""
    order = np.argsort(-share, kind="stable")
    running = np.cumsum(share[order])
    last = int(np.searchsorted(running, COVERED * running[-1]))  # the first with which the running sum is enough
    return order[: last + 1]


def _window(size: tuple[int, int], demand: Demand, factor: int) -> Window:
    """The smallest window, in whole boxes, that holds the visible part of the texture and a box around it."""
    height, width = size
    whole = Window.whole(size, factor)
    uv = demand.uv(size)
    across, up = periods(size)
    # Rows count from the top, where v is 1.
    top, tall = _shortest_stretch(1 - uv[:, 1], up * demand.footprint, height, factor, whole.height)
    left, wide = _shortest_stretch(uv[:, 0], across * demand.footprint, width, factor, whole.width)
    return Window(size, top, left, tall, wide, factor)


def _shortest_stretch(place: Array, footprint: Array, side: int, factor: int, whole: int) -> tuple[int, int]:
    """Start and length, in texels, of the shortest stretch of one side of the texture that holds all that queries see.

    Each of them sees its `place` (n,) with its `footprint` (n,), both in periods of `side` texels. The stretch may wrap
    around, and has whole boxes of `factor` texels. If it would not be shorter than `whole`, the side in whole boxes, it
    is (0, `whole`).
    """
    reach = footprint / 2 + factor / side  # in periods: half the footprint, and a box
    if float(reach.max()) >= 0.5:
        return 0, whole
    first = np.floor((place - reach) * side).astype(int)
    end = np.ceil((place + reach) * side).astype(int)  # the texel after the last that is seen
    seen = np.flatnonzero(_seen_texels(first, end, side))
    # The longest part that nobody sees is left out. From each seen texel to the next one is a step of 1, or more over
    # unseen texels; the last step leads around the period to the first.
    next_seen = np.append(seen[1:], seen[0] + side)
    steps = next_seen - seen
    longest = int(np.argmax(steps))
    unseen = int(steps[longest]) - 1  # texels that it jumps over
    length = math.ceil((side - unseen) / factor) * factor  # in whole boxes
    if length >= whole:
        return 0, whole
    return int(next_seen[longest]) % side, length


def _seen_texels(first: Array, end: Array, side: int) -> Array:
    """Whether any query sees each texel of a side, (side,) bool; query i sees those from first[i] on, before end[i].

    Both (n,) are from −side to 2 · side: a query may see texels of the period before, or after, which repeat it.
    """
    # +1 where what a query sees begins and −1 where it ends, over three periods: before, the texture's own, and after.
    # The running sum is the number of queries that see a texel.
    edges = np.zeros(3 * side + 1, int)
    np.add.at(edges, first + side, 1)
    np.add.at(edges, end + side, -1)
    queries = np.cumsum(edges)[:-1].reshape(3, side)
    return np.asarray((queries > 0).any(0))


def _cells_around(directions: Array) -> Array:
    """Map (CELLS, CELLS) of the cells that hold directions (n, 3), and of those around them."""
    row, col = np.divmod(cell_of(torch.from_numpy(directions)).numpy(), CELLS)
    held = np.zeros((CELLS, CELLS), bool)
    held[row, col] = True
    return np.asarray(binary_dilation(held, np.ones((3, 3))))


def pair_weights(layout: Layout, demand: Demand, radiance: bool = False) -> Weights:
    """The k pairs around each query, and their weights, both (n, k), as `bench.directions.interpolation` finds them.

    The weights of a query are shares that add up to one; with `radiance` they are those by which radiance is
    interpolated, including cosines.
    """
    interpolator = PairInterpolator(layout)
    search = interpolator if radiance else interpolator.shares
    wo, wi = torch.from_numpy(demand.wo), torch.from_numpy(demand.wi)
    parts = []
    for some_wo, some_wi in zip(wo.split(CHUNK), wi.split(CHUNK), strict=True):
        parts.append(search(some_wo, some_wi))
    sample = torch.cat([part.sample for part in parts])
    weight = torch.cat([part.weight for part in parts])
    return Weights(sample.int(), weight.float())


def pair_shares(layout: Layout, demand: Demand) -> Array:
    """The share (N,) of the demand that falls on each pair; they add up to one."""
    return shares_from_weights(pair_weights(layout, demand), demand.importance, len(layout.view))


def shares_of_others(layout: Layout, demand: Demand, wo: Array, wi: Array) -> Array:
    """The demand (n,) around other pairs than the layout's, at directions `wo` and `wi` (n, 3).

    It is the mean share of the layout's pairs that surround each one; 0 where the scene uses less than half of these,
    by their weights. Adds up to one, or to 0 if the scene comes near none.
    """
    shares = pair_shares(layout, demand)
    surrounding = PairInterpolator(layout).shares(torch.from_numpy(wo), torch.from_numpy(wi))
    weight = surrounding.weight.numpy()  # (n, k)
    share_of_surrounding = shares[surrounding.sample.numpy()]  # (n, k)
    is_near = (weight * (share_of_surrounding > 0)).sum(1) >= 0.5
    mean_share = (weight * share_of_surrounding).sum(1)
    demand_around = np.where(is_near, mean_share, 0.0)
    return demand_around / max(demand_around.sum(), 1e-30)


def shares_from_weights(weights: Weights, importance: Array, count: int) -> Array:
    """The share (count,) of the demand on each of `count` pairs: each query divides its `importance` (n,) among the
    pairs around it by their weights (n, k)."""
    weight = weights.weight.numpy() * importance[:, None]
    return np.bincount(weights.sample.numpy().ravel(), weight.ravel(), count)
