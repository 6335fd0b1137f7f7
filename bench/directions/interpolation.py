"""The suite's only interpolator between sampled directions, in PyTorch.

A *side* is the views, or the lights, of all pairs. One hemisphere is triangulated by Delaunay in its stereographic
plane, where circles of the sphere stay circles, so the result is also the triangulation on the sphere; weights are
barycentric in that plane. Pairs that form a product views × lights use the tensor product of the two sides (3 × 3
pairs); scattered pairs use modified Shepard weights over the nearest eight. A side that spans no triangle (one or two
directions, or all on one line of the plane) uses the nearest. A direction outside the hull is projected onto it.

The interpolated quantity is radiance / cos θ_i, multiplied by the cosine of the query. `PairInterpolator` folds both
cosines into its weights, so a caller only sums weight × radiance.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.distance import cdist
from torch import Tensor, nn

from bench.btf import Layout
from bench.machine.devices import is_gpu

CELLS = 64  # cells per side of the grid of candidate triangles: about two candidates a cell for the published sets
MOST_CANDIDATES = 4096  # in a cell; a file with more is not a measurement, but could exhaust memory
BLOCK = 1 << 22  # queries × candidates that are searched at once
SHEPARD_NEIGHBOURS = 8
UNIT = 1e-3  # tolerance of a stored direction's length, and of its distance below the horizon
MOST_IMPLIED = 1 << 16  # pairs that views and lights tell: a small file could name too many for memory
ROUNDING = 1e-4  # in float32, barycentric weights of a sample itself may be as low as −2e-5


class Weights(NamedTuple):
    """The samples between which a query is interpolated, and their weights: both (n, k)."""

    sample: Tensor
    weight: Tensor


def stereographic(directions: Tensor) -> Tensor:
    """The plane coordinates (n, 2) of unit directions (n, 3) of the upper hemisphere: xy / (1 + z)."""
    return directions[:, :2] / (1 + directions[:, 2:])


class Hemisphere(nn.Module):
    """Barycentric weights over the sampled directions (m, 3) of one side; call it with queries (n, 3)."""

    def __init__(self, directions: np.ndarray):
        """Triangulate directions (m, 3) in the stereographic plane, unless they span no triangle."""
        super().__init__()
        points = stereographic(torch.as_tensor(directions, dtype=torch.float64))
        self.register_buffer("points", points.float())
        # Fewer than three samples, or samples on one line of the plane, span no triangle: then the nearest answers.
        from_first = points.numpy() - points[0].numpy()
        self.flat = len(directions) < 3 or np.linalg.matrix_rank(from_first, tol=1e-6) < 2
        if not self.flat:
            self._triangulate(points.numpy())

    # Where `flat`, only `points` is set.
    triangles: Tensor  # (t, 3) indices of the samples at the corners
    edges: Tensor  # (e, 2, 2) the two ends of each edge of the hull, x and y
    candidates: Tensor  # (cells, k) triangles to search; see `_candidates`
    affine: Tensor  # (t, 2, 3) from a point to its weights of the second and the third corner
    points: Tensor  # (m, 2) the samples in the plane

    def _triangulate(self, points: np.ndarray) -> None:
        """Triangulate the samples (m, 2) of the plane, and keep what a search needs as buffers."""
        triangles = Delaunay(points).simplices  # (t, 3): numbers of the samples at the corners
        corners = points[triangles]  # (t, 3, 2)
        # (t, 2, 2), an edge a column.
        spans = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], -1)
        has_area = np.abs(np.linalg.det(spans)) > 1e-9  # Qhull keeps degenerate slivers of collinear rings; drop them
        triangles, corners, spans = triangles[has_area], corners[has_area], spans[has_area]
        inverse = np.linalg.inv(spans)
        # Barycentric (b1, b2) = inverse @ (p − corner0) as one affine map a triangle: [2, 3].
        affine = np.concatenate([inverse, -(inverse @ corners[:, 0, :, None])], -1)
        hull = ConvexHull(points).simplices  # (e, 2): numbers of the samples at the ends of each edge
        self.register_buffer("triangles", torch.as_tensor(triangles, dtype=torch.long))
        self.register_buffer("affine", torch.as_tensor(affine, dtype=torch.float32))
        self.register_buffer("edges", torch.as_tensor(points[hull], dtype=torch.float32))
        self.register_buffer("candidates", torch.as_tensor(_candidates(corners), dtype=torch.long))

    def outside(self, queries: Tensor) -> Tensor:
        """Mask (n,) of the queries (n, 3) that lie outside the hull of the samples by more than rounding; all lie
        outside of samples that span no triangle."""
        if self.flat:
            return torch.ones(len(queries), dtype=torch.bool, device=queries.device)
        _, weights = self._barycentric(stereographic(queries))
        return weights.amin(1) < -ROUNDING

    def _barycentric(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """The triangle (n,) that holds each point (n, 2), or the candidate nearest to it, and its weights (n, 3)."""
        triangle, weights = _in_blocks(self._best_candidate, self.candidates.shape[1], points)
        return triangle, weights

    def _best_candidate(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """What `_barycentric` promises, for one block of points: the candidate whose least weight is largest. Inside a
        triangle no weight is negative."""
        cell = ((points + 1) * (CELLS / 2)).long().clamp(0, CELLS - 1)  # column and row; rows go up with y
        candidates = self.candidates[cell[:, 1] * CELLS + cell[:, 0]]  # (n, k), as a to f
        # One number of the map at a time, because tensors (n, candidates, 2, 2) take twice as long.
        a, b, c, d, e, f = self.affine.flatten(1)[candidates].unbind(-1)
        x, y = points[:, :1], points[:, 1:]
        second = a * x + b * y + c
        third = d * x + e * y + f
        first = 1 - (second + third)
        best = torch.minimum(torch.minimum(first, second), third).argmax(1, keepdim=True)  # (n, 1)
        weights = torch.cat([weight.gather(1, best) for weight in (first, second, third)], 1)
        return candidates.gather(1, best)[:, 0], weights

    def _onto_hull(self, points: Tensor) -> Tensor:
        """The point on the border of the hull (n, 2) that is nearest to each point (n, 2)."""
        return _in_blocks(self._nearest_on_border, len(self.edges), points)[0]

    def _nearest_on_border(self, points: Tensor) -> tuple[Tensor]:
        """What `_onto_hull` promises, for one block of points; a tuple, as `_in_blocks` needs it."""
        start, end = self.edges[:, 0], self.edges[:, 1]  # (e, 2) each
        along = end - start
        # The place along each edge, 0 at its start and 1 at its end: (n, e).
        t = ((points[:, None] - start) * along).sum(-1) / (along * along).sum(-1)
        nearest = start + t.clamp(0, 1)[..., None] * along  # (n, e, 2)
        best = (points[:, None] - nearest).square().sum(-1).argmin(1)
        return (nearest[torch.arange(len(points), device=points.device), best],)

    def _nearest_sample(self, points: Tensor) -> tuple[Tensor]:
        """The index (n, 1) of the sample nearest to each point (n, 2) of a block; a tuple, as `_in_blocks` needs it."""
        return (torch.cdist(points, self.points.to(points.dtype)).argmin(1, keepdim=True),)

    def forward(self, queries: Tensor) -> Weights:
        """Samples of queries (n, 3) and their weights, which add up to one: (n, 3), or (n, 1) without a triangle."""
        points = stereographic(queries)
        if self.flat:
            (index,) = _in_blocks(self._nearest_sample, len(self.points), points)
            return Weights(index, torch.ones_like(index, dtype=points.dtype))
        triangle, weights = self._barycentric(points)
        outside = weights.amin(1) < -ROUNDING
        # A program has no branches, and a GPU would be waited for: compute both answers, then choose.
        if torch.compiler.is_exporting() or is_gpu(points.device):
            of_hull, weights_there = self._barycentric(self._onto_hull(points))
            triangle = torch.where(outside, of_hull, triangle)
            weights = torch.where(outside[:, None], weights_there, weights)
        elif outside.any():
            triangle[outside], weights[outside] = self._barycentric(self._onto_hull(points[outside]))
        weights = weights.clamp_min(0)
        return Weights(self.triangles[triangle], weights / weights.sum(1, keepdim=True))


def _candidates(corners: np.ndarray) -> np.ndarray:
    """For each cell of a grid over [−1, 1]², the triangles (cells, k) that may hold a point of it.

    These are the triangles whose bounding boxes meet the cell; if there are none, the nearest one.
    """
    low, high = corners.min(1), corners.max(1)  # of `corners` (t, 3, 2)
    slack = 1e-6  # a point on the border of a box may lie a rounding error beyond it
    edges = np.linspace(-1, 1, CELLS + 1)
    # Whether each triangle's box meets each column, and each row, of cells: (t, CELLS).
    x = (low[:, None, 0] <= edges[1:] + slack) & (high[:, None, 0] >= edges[:-1] - slack)
    y = (low[:, None, 1] <= edges[1:] + slack) & (high[:, None, 1] >= edges[:-1] - slack)
    met = y.T[:, None] & x.T  # (rows, columns, triangles)
    middle = (edges[1:] + edges[:-1]) / 2  # of each column, and of each row
    rows, columns = np.nonzero(~met.any(2))  # cells that no box meets
    nearest = cdist(np.stack([middle[columns], middle[rows]], 1), corners.mean(1)).argmin(1)
    met[rows, columns, nearest] = True
    return _listed(met.reshape(CELLS**2, -1))


def _listed(met: np.ndarray) -> np.ndarray:
    """The triangles (cells, k) that a mask (cells, triangles) marks, at least one in each cell.

    Rows are padded by repeating their first entry, which changes no answer.
    """
    cell, triangle = np.nonzero(met)
    counts = np.bincount(cell)
    most = counts.max()
    if most > MOST_CANDIDATES:
        raise ValueError(f"{most:,} triangles of directions meet in one place, but the limit is {MOST_CANDIDATES:,}")
    starts = np.cumsum(counts) - counts
    padded = np.repeat(triangle[starts, None], most, axis=1)
    # `np.nonzero` goes cell by cell, so an entry's column is its distance from the first entry of its cell.
    padded[cell, np.arange(len(cell)) - starts[cell]] = triangle
    return padded


def _in_blocks(answer: Callable[[Tensor], tuple[Tensor, ...]], width: int, queries: Tensor) -> tuple[Tensor, ...]:
    """The answers to queries (n, …), in blocks if a table (n, width) of them would take too much memory."""
    rows = max(1, BLOCK // width)
    if len(queries) <= rows or torch.compiler.is_compiling():
        return answer(queries)
    parts = [answer(some) for some in queries.split(rows)]
    return tuple(torch.cat(blocks) for blocks in zip(*parts, strict=True))


def cosines(layout: Layout) -> Tensor:
    """The cosine of the light of each pair (N,), at least 1e-3, because radiance is divided by it."""
    return torch.from_numpy(layout.lights[layout.light, 2]).clamp_min(1e-3)


class PairInterpolator(nn.Module):
    """Weights over the sampled pairs of a BTF for any query of directions. See the module for the scheme."""

    def __init__(self, layout: Layout):
        """Prepare the search: among views and among lights if the pairs are their product, else among pairs."""
        super().__init__()
        self.product = layout.grid is not None
        self.register_buffer("cos_i", cosines(layout))
        if layout.grid is not None:
            self.views, self.lights = Hemisphere(layout.views), Hemisphere(layout.lights)
            self.register_buffer("grid", torch.as_tensor(layout.grid))
        else:
            pairs = np.concatenate([layout.views[layout.view], layout.lights[layout.light]], 1)
            self.register_buffer("pairs", torch.as_tensor(pairs, dtype=torch.float32))

    cos_i: Tensor  # (N,) cosine of each pair's light
    grid: Tensor  # (V, L) pair of each view and light; only of a product
    pairs: Tensor  # (N, 6) ω_o and ω_i of each pair; only if scattered

    @property
    def reads(self) -> int:
        """The number of samples for one query."""
        if not self.product:
            return min(SHEPARD_NEIGHBOURS, len(self.pairs))
        of_view = 1 if self.views.flat else 3  # the nearest sample, or the corners of a triangle
        of_light = 1 if self.lights.flat else 3
        return of_view * of_light

    def forward(self, wo: Tensor, wi: Tensor) -> Weights:
        """Pair indices and weights (n, k) of queries wo, wi (n, 3): radiance = Σ weight · radiance of the pair."""
        index, share = self.shares(wo, wi)
        return Weights(index, share * wi[:, 2:] / self.cos_i[index].to(share.dtype))

    def shares(self, wo: Tensor, wi: Tensor) -> Weights:
        """Pair indices and weights (n, k) that add up to one, for callers that handle the cosines themselves."""
        search = self._tensor_product if self.product else self._shepard
        # A slice has one pair of directions, expanded to all texels, so that each row lies in the same memory.
        if len(wo) > 1 and wo.stride(0) == wi.stride(0) == 0:
            sample, weight = search(wo[:1], wi[:1])
            return Weights(sample.expand(len(wo), -1), weight.expand(len(wo), -1))
        return search(wo, wi)

    def mean_cosine(self, pair: Tensor, share: Tensor, level: Tensor) -> Tensor:
        """The effective cosine (n, 3) of the samples' lights, given their interpolated logarithms `level` (n, 3).

        The c for which log1p(r · c) = Σ share · log1p(r · cosine) = level, to second order in the cosines' spread: the
        arithmetic mean where the level is low and the logarithm nearly linear, the geometric mean where it is high. A
        caller that interpolates log1p(radiance) by `shares` multiplies the radiance by the query's cosine over this.
        """
        cosine = self.cos_i[pair].to(share.dtype)
        arithmetic = (share * cosine).sum(1, keepdim=True).log()
        geometric = (share * cosine.log()).sum(1, keepdim=True)
        return torch.exp(arithmetic - level.neg().expm1() * (geometric - arithmetic))

    def _tensor_product(self, wo: Tensor, wi: Tensor) -> Weights:
        """Pairs and weights (n, k) of each sample of the view with each of the light, the light fastest."""
        view, light = self.views(wo), self.lights(wi)
        index = self.grid[view.sample[:, :, None], light.sample[:, None, :]]  # (n, views, lights)
        weight = view.weight[:, :, None] * light.weight[:, None, :]
        return Weights(index.flatten(1), weight.flatten(1))

    def _shepard(self, wo: Tensor, wi: Tensor) -> Weights:
        """Modified Shepard weights over the nearest pairs, by the distance of (ω_o, ω_i) in R⁶.

        Weights fall to zero at the first pair left out, so the result is continuous where the nearest pairs change:
        Franke and Nielson, "Smooth interpolation of large sets of scattered data", IJNME 15 (1980).
        """
        distance, index = _in_blocks(self._neighbours, len(self.pairs), torch.cat([wo, wi], 1))
        distance = distance.clamp_min(1e-6)  # a query at a sample would divide by 0
        if len(self.pairs) <= SHEPARD_NEIGHBOURS:
            weight = 1 / distance.square()
        else:
            distance, index, radius = distance[:, :-1], index[:, :-1], distance[:, -1:]
            weight = (1 / distance - 1 / radius).square()
            all_equally_far = weight.sum(1, keepdim=True) == 0
            weight = torch.where(all_equally_far, 1 / distance.square(), weight)
        return Weights(index, weight / weight.sum(1, keepdim=True))

    def _neighbours(self, queries: Tensor) -> tuple[Tensor, Tensor]:
        """Distances and indices (n, k) of the nearest pairs of queries (n, 6)."""
        # The fast product form cannot resolve distances below 3e-4, so it would not be exact at the samples.
        distance = torch.cdist(queries, self.pairs.to(queries.dtype), compute_mode="donot_use_mm_for_euclid_dist")
        nearest, index = distance.topk(min(SHEPARD_NEIGHBOURS + 1, len(self.pairs)), largest=False)
        return nearest, index

    def outside(self, wo: Tensor, wi: Tensor) -> Tensor:
        """Mask (n,) of the queries wo, wi (n, 3) whose view or light lies outside the hull of its side.

        A side that spans no triangle has no hull, and nothing is outside of it; nor is anything of scattered pairs.
        """
        outside = torch.zeros(len(wo), dtype=torch.bool, device=wo.device)
        if self.product:
            for side, queries in ((self.views, wo), (self.lights, wi)):
                if not side.flat:
                    outside = outside | side.outside(queries)
        return outside


def pack_layout(layout: Layout) -> dict[str, Tensor]:
    """Pack the distinct views and lights, and each pair's indices into them (N, 2), in the smallest integer type.

    Pairs that run through all products of views and lights, with the lights fastest or the views, need no indices.
    """
    sides = {"views": torch.from_numpy(layout.views), "lights": torch.from_numpy(layout.lights)}
    pairs = np.stack([layout.view, layout.light], 1)
    views_fastest = _views_fastest(layout)
    if views_fastest is not None and len(pairs) <= MOST_IMPLIED:
        if views_fastest:
            sides["views_fastest"] = torch.ones(1, dtype=torch.uint8)
        return sides
    most = max(len(layout.views), len(layout.lights))
    if most <= 256:
        dtype = torch.uint8
    elif most <= 32768:
        dtype = torch.int16
    else:
        dtype = torch.int32
    return sides | {"pairs": torch.from_numpy(pairs).to(dtype)}


def _product(views: int, lights: int, views_fastest: bool) -> np.ndarray:
    """The indices (views · lights, 2) of all views with all lights, the lights fastest, or the views."""
    if views_fastest:
        light, view = np.divmod(np.arange(views * lights), views)
    else:
        view, light = np.divmod(np.arange(views * lights), lights)
    return np.stack([view, light], 1)


def _views_fastest(layout: Layout) -> bool | None:
    """Whether the pairs run through a product with the views fastest, or with the lights; None if they do neither."""
    pairs = np.stack([layout.view, layout.light], 1)
    for views_fastest in (False, True):
        if np.array_equal(pairs, _product(len(layout.views), len(layout.lights), views_fastest)):
            return views_fastest
    return None


def picture_of_pairs(layout: Layout) -> tuple[int, int]:
    """The size (H, W) of the picture that the N pairs of a layout are, row by row: views by lights, or lights by views,
    where neighbours are near directions; 1 by N if the pairs do not run through a product in order."""
    views_fastest = _views_fastest(layout)
    if views_fastest is None:
        return 1, len(layout.view)
    views, lights = len(layout.views), len(layout.lights)
    return (lights, views) if views_fastest else (views, lights)


def unpack_layout(parts: dict[str, Tensor], rows: int | None = None) -> Layout:
    """Unpack the layout that `pack_layout` packed; `rows` is the number of pairs of the table, None if there is no
    table to fit. Raises `KeyError` if a tensor is missing, `ValueError` if one is invalid or does not fit the table."""
    views = parts["views"].float().numpy()
    lights = parts["lights"].float().numpy()
    if not (_are_directions(views) and _are_directions(lights)):
        raise ValueError("its directions are not unit vectors of the upper hemisphere")
    counts = (len(views), len(lights))
    pairs = np.empty((0, 2), np.int64)
    if "pairs" in parts:
        pairs = parts["pairs"].long().numpy()
    elif math.prod(counts) <= MOST_IMPLIED:  # asked before they are made
        pairs = _product(*counts, "views_fastest" in parts)
    are_indices = pairs.shape[1:] == (2,) and (pairs >= 0).all() and (pairs < counts).all()
    if not are_indices or len(pairs) == 0 or rows not in (None, len(pairs)):
        raise ValueError("its pairs are not those of its table and directions")
    return Layout(views, lights, pairs[:, 0], pairs[:, 1])


def _are_directions(side: np.ndarray) -> bool:
    """Whether an array holds directions (m, 3), at least one: unit vectors of the upper hemisphere, within `UNIT`."""
    if side.shape[1:] != (3,) or not len(side):
        return False
    # Bounded first, so that the squares of a norm cannot overflow.
    if not (side.min() >= -1 - UNIT and side.max() <= 1 + UNIT):  # also if one is NaN
        return False
    lengths = np.linalg.norm(side, axis=1)
    return bool((np.abs(lengths - 1) < UNIT).all() and side[:, 2].min() >= -UNIT)
