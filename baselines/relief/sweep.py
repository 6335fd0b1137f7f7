"""Finds the height of each texel by plane sweep: at which height do all views show the same surface?

At the right height z, the slices of every view, shifted by −z · ω_o.xy / ω_o.z, agree with those of the most frontal
view under the same light (Collins, "A space-sweep approach to true multi-image matching", CVPR 1996); `refine` then
improves it. Reflectance that changes with the view imitates a relief, so the two halves of the views test each other:
with a true relief, the components of surface points explain more of the other half, and both find the same height.

`refine` asks at which height each surface point looks most like the other points of the material. A sweep that
compares views with one another mistakes a highlight, which moves with the view, for parallax. So the ABRDFs of the
surface points at a first height give principal components, and a second sweep looks for the height at which they
explain most of a point's ABRDF. If much of the surface hides behind itself, the first height stays.

V is a number of views, (V, 3) as unit vectors; L is that of lights, the same for each view. Slices are here of log
radiance, as a mean over the channels: all are (V, L, H, W). A *height* (H, W) is in widths of the picture. The *surface
point* of a texel lies at its height above it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from baselines.relief.geometry import HEIGHTS, REACH, Surface, blurred, cheapest, refined, shifted, slope, wrapped
from bench.btf import BTF, Layout
from bench.codec import Fit
from bench.directions.hemisphere import thin
from bench.material import sample_texture, texel_centres

MOST_VIEWS, MOST_LIGHTS = 32, 32  # the most views and lights that are compared
MEMORY = 256 << 20  # bytes of slices that are kept; larger pictures use fewer lights
TRUNCATION = 0.5  # limit of a difference of log radiance, so that an occluded point does not outweigh the others
# Least values of the `SweptHeight` of a relief. Gain: a relief has 0.2 and more; noise and reflectance of planes have
# less than 0. Likeness: a relief has 0.8 and more, planes have less than 0.
LEAST_GAIN = 0.05
LEAST_LIKENESS = 0.5
LEAST_LEFT = 1e-4  # of log radiance: below, a plane leaves only rounding
COMPONENTS = 8  # of the ABRDFs: fewer miss highlights, more also explain blur
# `refine` looks beyond the first range of heights, on either side: by this share of it, and at least by so many widths.
BEYOND, LEAST_BEYOND = 0.15, 0.004
MOST_HIDDEN = 0.1  # largest share of points and views: satin has 0.01, brick 0.02, a rock 0.03, cable-knit 0.19


def refine(height: Tensor, slices: Tensor, views: Tensor) -> Tensor:
    """A better height (H, W), within ± `REACH`, than a first one, from log radiances (V, L, H, W) of views (V, 3).

    It is that at which components of the ABRDFs leave least, see the module; or the first one, if much of it is hidden.
    """
    if hidden_share(height, views) > MOST_HIDDEN:
        return height
    model = _components(height, slices, views)
    # The heights to try, evenly spaced around the range of the first ones.
    low, high = float(height.min()), float(height.max())
    beyond = max(BEYOND * (high - low), LEAST_BEYOND)
    heights = torch.linspace(max(low - beyond, -REACH), min(high + beyond, REACH), HEIGHTS)
    # At each height: what the components leave of every texel's ABRDF.
    costs = []
    for z in heights.tolist():
        # (N, H, W), the ABRDFs of points that all lie at height z; N is V · L.
        at_z = torch.cat([shifted(of_view, view, z) for of_view, view in zip(slices, views, strict=True)])
        centred = at_z.flatten(1) * model.weight - model.mean  # (N, H · W)
        cost = _residual(centred, model.basis).abs_().mean(0)
        costs.append(cost.reshape(height.shape))
    return refined(blurred(torch.stack(costs)), heights)


def unexplained_error(height: Tensor, slices: Tensor, views: Tensor) -> float:
    """The mean |log radiance| that the components of the surface points at a height do not explain.

    The components are of these points themselves. Arguments as of `refine`.
    """
    model = _components(height, slices, views)
    return float(_residual(model.centred, model.basis).abs().mean())


def _residual(centred: Tensor, basis: Tensor) -> Tensor:
    """What an orthonormal basis (N, k) does not explain of vectors (N, n): these without their projections on it."""
    return centred - basis @ (basis.T @ centred)


class _Components(NamedTuple):
    """Principal components of the ABRDFs of surface points; an ABRDF has N = V · L numbers, view by view."""

    centred: Tensor  # (N, H · W), the ABRDFs, weighted, without their mean
    mean: Tensor  # (N, 1), of the weighted ABRDFs over all points
    weight: Tensor  # (N, 1), of the view of each number
    basis: Tensor  # (N, `COMPONENTS`), orthonormal


def _components(height: Tensor, slices: Tensor, views: Tensor) -> _Components:
    """The components of the surface points at a height (H, W); arguments as of `refine`."""
    # (N, H · W)
    radiance = torch.cat([_at_surface(of_view, view, height) for of_view, view in zip(slices, views, strict=True)])
    # A grazing view sees many points poorly, so its weight in squares is ω_o.z.
    weight = views[:, 2].to(slices).sqrt().repeat_interleave(slices.shape[1])[:, None]
    mean = (radiance * weight).mean(1, keepdim=True)
    centred = radiance * weight - mean
    double = centred.double()
    _, eigenvectors = torch.linalg.eigh(double @ double.T)  # of a matrix (N, N)
    basis = eigenvectors[:, -COMPONENTS:]  # the last have the largest eigenvalues
    return _Components(centred, mean, weight, basis.to(radiance))


def hidden_share(height: Tensor, views: Tensor) -> float:
    """The share of surface points, over all views (V, 3), that another point hides by more than a texel."""
    surface = Surface(height)
    point_heights = height.reshape(-1, 1)  # (H · W, 1)
    shape = (height.shape[0], height.shape[1])
    count = 0
    for view in views.float():
        along = slope(view[None], shape)
        # A ray through the place where the view would show a point meets the point itself, or one that hides it.
        place = wrapped(_places(height, view))
        _, met_heights = surface.meet(place, view.expand(len(point_heights), 3))
        texels_apart = (met_heights - point_heights).abs() * along.norm() * shape[1]
        count += int((texels_apart > 1).sum())
    return count / (len(views) * len(point_heights))


def _at_surface(slices: Tensor, view: Tensor, height: Tensor) -> Tensor:
    """The log radiance (L, H · W) of each surface point in slices (L, H, W) of a view (3,), at its visible place."""
    place = wrapped(_places(height, view)).to(slices)
    return sample_texture(slices.permute(1, 2, 0), place).T


def _places(height: Tensor, view: Tensor) -> Tensor:
    """Where a view (3,) shows the surface points of the texels: uv (H · W, 2), not wrapped, row by row."""
    shape = (height.shape[0], height.shape[1])
    return texel_centres(*shape) - height.reshape(-1, 1) * slope(view[None].float(), shape)


@dataclass(frozen=True)
class SweptHeight:
    """The height (H, W) that a sweep finds with all views, and its evidence from halves of them; see the module."""

    height: Tensor
    gain: float  # least share of a plane's error in one half of the views that the other half's relief explains
    likeness: float  # correlation of the heights that two halves of the views find

    @property
    def stands(self) -> bool:
        """Whether it is a relief, and not an effect of noise or reflectance on a plane."""
        return self.gain >= LEAST_GAIN and self.likeness >= LEAST_LIKENESS


def find(btf: BTF, gain: float, fit: Fit) -> SweptHeight | None:
    """The relief that the slices of a BTF show best; None if there are too few views or lights to tell.

    `gain` is the factor of log radiance. Whether it is a relief at all, `SweptHeight.stands` says.
    """
    grid = _grid(btf.layout)
    if grid is None:
        return None
    # The view of each row of the grid is that of its first pair.
    view_numbers = btf.layout.view[grid[:, 0]]
    views = torch.from_numpy(btf.layout.views[view_numbers]).float()  # (V, 3)
    slices = _read(btf, grid, gain, fit)
    # Every other view, beside the most frontal one, which is in both halves.
    halves = ([0, *range(1, len(views), 2)], [0, *range(2, len(views), 2)])
    heights = [_swept(slices[half], views[half]) for half in halves]
    # Each height is tested on the half of the views with which it was not found.
    gains = []
    for height, other_half in zip(heights, reversed(halves), strict=True):
        test_slices, test_views = slices[other_half], views[other_half]
        plane_error = unexplained_error(torch.zeros_like(height), test_slices, test_views)
        relief_error = unexplained_error(height, test_slices, test_views)
        # If even the plane leaves only rounding, the gain is near 0.
        gains.append((plane_error - relief_error) / max(plane_error, LEAST_LEFT))
    likeness = _likeness(heights[0].flatten(), heights[1].flatten())
    return SweptHeight(_swept(slices, views), min(gains), likeness)


def _swept(slices: Tensor, views: Tensor) -> Tensor:
    """The height (H, W) at which views (V, 3) of slices (V, L, H, W) agree.

    A coarse sweep over all heights, a fine one over the range that it found, and `refine`. The first view is the most
    frontal.
    """
    coarse_heights = torch.linspace(-REACH, REACH, HEIGHTS)
    # The lowest and the highest of the texels' cheapest heights.
    lowest, highest = cheapest(_costs(slices, views, coarse_heights)).aminmax()  # as indices
    low, high = float(coarse_heights[int(lowest)]), float(coarse_heights[int(highest)])
    step = float(coarse_heights[1] - coarse_heights[0])
    fine_heights = torch.linspace(low - step, high + step, HEIGHTS)
    first_height = refined(_costs(slices, views, fine_heights), fine_heights)
    return refine(first_height, slices, views)


def _likeness(a: Tensor, b: Tensor) -> float:
    """The correlation of two heights (n,); 0 where one is constant."""
    a, b = a - a.mean(), b - b.mean()
    return float((a @ b) / (a.norm() * b.norm()).clamp_min(1e-12))


def _grid(layout: Layout) -> np.ndarray | None:
    """Indices of pairs (V, L) of some views, the most frontal first, each with the same lights; None if there are too
    few: below three views or two lights. A layout says which view and light each pair of the BTF has."""
    pairs = np.full((len(layout.views), len(layout.lights)), -1)  # (views, lights); −1: not measured
    pairs[layout.view, layout.light] = np.arange(len(layout.view))
    measured = pairs >= 0
    # The most frontal of the views that have two lights or more.
    frontality = np.where(measured.sum(1) > 1, layout.views[:, 2], -1)
    front = int(np.argmax(frontality))
    lights = np.flatnonzero(measured[front])
    spread_evenly = thin(layout.lights[lights], count=min(MOST_LIGHTS, len(lights)))
    lights = lights[spread_evenly]
    # The other views that have all these lights.
    complete_views = np.flatnonzero(measured[:, lights].all(1))
    other_views = complete_views[complete_views != front]
    if len(lights) < 2 or len(other_views) < 2:  # each half of the views needs one beside the most frontal
        return None
    spread_evenly = thin(layout.views[other_views], count=min(MOST_VIEWS - 1, len(other_views)))
    views = np.concatenate([[front], other_views[spread_evenly]])
    return pairs[views][:, lights]


def _read(btf: BTF, grid: np.ndarray, gain: float, fit: Fit) -> Tensor:
    """Log radiance (V, l, H, W), the mean of the channels, of a grid of pairs (V, L), on the device of the fit.

    Of the first l of its lights, as many as fit in `MEMORY`, at least two. Shows progress.
    """
    height, width = btf.shape
    bytes_of_a_light = len(grid) * height * width * 4  # one float32 a texel and view
    most_lights = max(2, MEMORY // bytes_of_a_light)
    grid = grid[:, :most_lights]
    slices = []
    for picture in fit.progress(btf.subset(grid.reshape(-1)), "sweeping", grid.size):
        log_radiance = torch.from_numpy(np.maximum(picture, 0)).mul_(gain).log1p_()  # (H, W, 3)
        slices.append(log_radiance.mean(-1))
    return torch.stack(slices).reshape(*grid.shape, *btf.shape).to(fit.device)


def _costs(slices: Tensor, views: Tensor, heights: Tensor) -> Tensor:
    """The disagreement of the views with the first at each height and surface point, (heights, H, W), blurred.

    It is the mean difference of log radiance, up to `TRUNCATION`. `slices` are (V, L, H, W), `views` (V, 3).
    """
    costs = torch.zeros(len(heights), *slices.shape[2:], device=slices.device)
    weights = (views[1:, 2] / views[1:, 2].sum()).tolist()  # views count by their cosine; all weights add up to 1
    for i, z in enumerate(heights.tolist()):
        front = shifted(slices[0], views[0], z)  # (L, H, W)
        for view, of_view, weight in zip(views[1:], slices[1:], weights, strict=True):
            difference = (shifted(of_view, view, z) - front).abs_().clamp_max_(TRUNCATION)
            costs[i].add_(difference.mean(0), alpha=weight)
    return blurred(costs)
