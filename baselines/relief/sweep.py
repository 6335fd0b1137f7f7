"""Finds the height of each texel by plane sweep: at which height do all views show the same surface?

At the right height z, the slices of every view, shifted by −z · ω_o.xy / ω_o.z, agree with those of the most frontal
view under the same light (Collins, "A space-sweep approach to true multi-image matching", CVPR 1996); `refine` then
improves it. Reflectance that changes with the view imitates a relief, so the two halves of the views test each other:
with a true relief, the components of surface points explain more of the other half, and both find the same height.

`refine` asks at which height each surface point looks most like the other points of the material. A sweep that
compares views with one another mistakes a highlight, which moves with the view, for parallax. So the ABRDFs of the
surface points at a first height give principal components, and a second sweep looks for the height at which they
explain most of a point's ABRDF. If much of the surface hides behind itself, the first height stays.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from baselines.relief.geometry import HEIGHTS, REACH, Surface, blurred, least, refined, shifted, slope, wrapped
from bench.btf import BTF, Layout
from bench.codec import Fit
from bench.directions.hemisphere import thin
from bench.material import sample_texture, texel_centres

MOST_VIEWS, MOST_LIGHTS = 32, 32  # the most views and lights that are compared
MEMORY = 256 << 20  # bytes of slices that are kept; larger pictures use fewer lights
TRUNCATION = 0.5  # limit of a difference of log radiance, so that an occluded point does not outweigh the others
LEAST_GAIN = 0.05  # a relief has 0.2 and more; noise and reflectance of planes have less than 0
LEAST_LEFT = 1e-4  # of log radiance: below, a plane leaves only rounding
LEAST_LIKENESS = 0.5  # a relief has 0.8 and more, planes have less than 0
COMPONENTS = 8  # of the ABRDFs: fewer miss highlights, more also explain blur
BEYOND, LEAST_BEYOND = 0.15, 0.004  # share of the first range, on either side; and the least widths of the picture
MOST_HIDDEN = 0.1  # largest share of points and views: satin has 0.01, brick 0.02, a rock 0.03, cable-knit 0.19


def refine(height: Tensor, slices: Tensor, views: Tensor) -> Tensor:
    """A height (H, W) within ± `REACH`, from a first one and log radiances (V, L, H, W) of views (V, 3)."""
    if hidden(height, views) > MOST_HIDDEN:
        return height
    _, mean, weight, basis = _components(height, slices, views)
    low, high = float(height.min()), float(height.max())
    beyond = max(BEYOND * (high - low), LEAST_BEYOND)
    heights = torch.linspace(max(low - beyond, -REACH), min(high + beyond, REACH), HEIGHTS)
    costs = []
    for z in heights.tolist():
        moved = torch.cat([shifted(each, view, z) for each, view in zip(slices, views, strict=True)])
        left = moved.flatten(1) * weight - mean  # (N, H · W)
        # What the components do not explain: the vectors without their projections on the orthonormal basis.
        costs.append((left - basis @ (basis.T @ left)).abs_().mean(0).reshape(height.shape))
    return refined(blurred(torch.stack(costs)), heights)


def unexplained(height: Tensor, slices: Tensor, views: Tensor) -> float:
    """The mean |log radiance| that the components of the surface points do not explain; arguments as of `refine`."""
    apart, _, _, basis = _components(height, slices, views)
    return float((apart - basis @ (basis.T @ apart)).abs().mean())


def _components(height: Tensor, slices: Tensor, views: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The surface points' weighted ABRDFs (N, H · W) without their mean, that mean, the weights and the components.

    Mean and weights are (N, 1), the components (N, `COMPONENTS`) orthonormal. N counts views and lights.
    """
    radiance = torch.cat([_at_surface(each, view, height) for each, view in zip(slices, views, strict=True)])
    # A grazing view sees many points poorly, so its weight in squares is ω_o.z.
    weight = views[:, 2].to(slices).sqrt().repeat_interleave(slices.shape[1])[:, None]
    mean = (radiance * weight).mean(1, keepdim=True)
    apart = radiance * weight - mean
    double = apart.double()
    basis = torch.linalg.eigh(double @ double.T)[1][:, -COMPONENTS:]  # the last have the largest eigenvalues
    return apart, mean, weight, basis.to(radiance)


def hidden(height: Tensor, views: Tensor) -> float:
    """The share of surface points, over all views (V, 3), that another point hides by more than a texel."""
    surface = Surface(height)
    flat = height.reshape(-1, 1)
    shape = (height.shape[0], height.shape[1])
    count = 0
    for view in views.float():
        along = slope(view[None], shape)
        _, met = surface.meet(wrapped(_places(height, view)), view.expand(len(flat), 3))  # heights (H · W, 1)
        count += int(((met - flat).abs() * along.norm() * shape[1] > 1).sum())
    return count / (len(views) * len(flat))


def _at_surface(slices: Tensor, view: Tensor, height: Tensor) -> Tensor:
    """The log radiance (L, H · W) of each surface point in slices (L, H, W) of a view (3,), at its visible place."""
    return sample_texture(slices.permute(1, 2, 0), wrapped(_places(height, view)).to(slices)).T


def _places(height: Tensor, view: Tensor) -> Tensor:
    """Where a view (3,) shows the surface points of the texels: uv (H · W, 2), not wrapped."""
    shape = (height.shape[0], height.shape[1])
    return texel_centres(*shape) - height.reshape(-1, 1) * slope(view[None].float(), shape)


@dataclass(frozen=True)
class SweptHeight:
    """The height (H, W) that a sweep finds, and its evidence; see the module."""

    height: Tensor
    gain: float  # least share of a plane's error in one half of the views that the other half's relief explains
    likeness: float  # correlation of the heights that two halves of the views find

    @property
    def stands(self) -> bool:
        """Whether it is a relief, and not an effect of noise or reflectance on a plane."""
        return self.gain >= LEAST_GAIN and self.likeness >= LEAST_LIKENESS


def find(btf: BTF, gain: float, fit: Fit) -> SweptHeight | None:
    """The relief that the slices of a BTF show best; None if there are too few views or lights to tell."""
    grid = _grid(btf.layout)
    if grid is None:
        return None
    # The view of each row of the grid is that of its first pair: (V, 3).
    views = torch.from_numpy(btf.layout.views[[int(btf.layout.view[row[0]]) for row in grid]]).float()
    slices = _read(btf, grid, gain, fit)
    halves = [[0, *range(start, len(views), 2)] for start in (1, 2)]  # the most frontal view is in both
    heights = [_swept(slices[half], views[half]) for half in halves]
    # Each half's height is tested on the other half of the views.
    gains = []
    for height, half in zip(heights, halves[::-1], strict=True):
        plane, relief = (unexplained(each, slices[half], views[half]) for each in (torch.zeros_like(height), height))
        gains.append((plane - relief) / max(plane, LEAST_LEFT))
    return SweptHeight(_swept(slices, views), min(gains), _likeness(*(height.flatten() for height in heights)))


def _swept(slices: Tensor, views: Tensor) -> Tensor:
    """The height (H, W) at which views (V, 3) of slices (V, L, H, W) agree.

    A coarse sweep over all heights, a fine one over the range that it found, and `refine`.
    """
    heights = torch.linspace(-REACH, REACH, HEIGHTS)
    # The lowest and the highest of the texels' cheapest heights.
    low, high = (float(heights[int(i)]) for i in least(_costs(slices, views, heights)).aminmax())
    step = float(heights[1] - heights[0])
    heights = torch.linspace(low - step, high + step, HEIGHTS)
    return refine(refined(_costs(slices, views, heights), heights), slices, views)


def _likeness(one: Tensor, other: Tensor) -> float:
    """The correlation of two heights (n,); 0 where one is constant."""
    one, other = one - one.mean(), other - other.mean()
    return float((one @ other) / (one.norm() * other.norm()).clamp_min(1e-12))


def _grid(layout: Layout) -> np.ndarray | None:
    """Pairs (V, L) of some views, the most frontal first, each with the same lights; None if there are too few."""
    pairs = np.full((len(layout.views), len(layout.lights)), -1)  # −1: not measured
    pairs[layout.view, layout.light] = np.arange(len(layout.view))
    # The most frontal of the views that have two lights or more.
    front = int(np.argmax(np.where((pairs >= 0).sum(1) > 1, layout.views[:, 2], -1)))
    lights = np.flatnonzero(pairs[front] >= 0)
    lights = lights[thin(layout.lights[lights], min(MOST_LIGHTS, len(lights)))]
    full = np.flatnonzero((pairs[:, lights] >= 0).all(1))
    full = full[full != front]
    if len(lights) < 2 or len(full) < 2:
        return None
    full = full[thin(layout.views[full], min(MOST_VIEWS - 1, len(full)))]
    return pairs[np.concatenate([[front], full])][:, lights]


def _read(btf: BTF, grid: np.ndarray, gain: float, fit: Fit) -> Tensor:
    """Log radiance (V, l, H, W), the mean of the channels, of a grid of pairs (V, L).

    Of as many of its lights as fit in `MEMORY`, at least two.
    """
    height, width = btf.shape
    bytes_of_a_light = len(grid) * height * width * 4  # one float32 a texel and view
    most_lights = max(2, MEMORY // bytes_of_a_light)
    grid = grid[:, :most_lights]
    slices = fit.progress(btf.subset(grid.reshape(-1)), "sweeping", grid.size)
    logs = [torch.from_numpy(np.maximum(each, 0)).mul_(gain).log1p_().mean(-1) for each in slices]
    return torch.stack(logs).reshape(*grid.shape, *btf.shape).to(fit.device)


def _costs(slices: Tensor, views: Tensor, heights: Tensor) -> Tensor:
    """The disagreement of the views with the first at each height and surface point: (heights, H, W)."""
    costs = torch.zeros(len(heights), *slices.shape[2:], device=slices.device)
    weights = (views[1:, 2] / views[1:, 2].sum()).tolist()
    for i, z in enumerate(heights.tolist()):
        front = shifted(slices[0], views[0], z)
        # Each (L, H, W); views count by their cosine, the sum of all weights being 1.
        for view, each, weight in zip(views[1:], slices[1:], weights, strict=True):
            apart = (shifted(each, view, z) - front).abs_().clamp_max_(TRUNCATION)
            costs[i].add_(apart.mean(0), alpha=weight)
    return blurred(costs)
