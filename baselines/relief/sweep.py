"""Finds the height of each texel by plane sweep: at which height do all views show the same surface?

At the right height z, the slices of every view, shifted by −z · ω_o.xy / ω_o.z, agree with those of the most frontal
view under the same light (Collins, "A space-sweep approach to true multi-image matching", CVPR 1996); `refine` then
improves it. Reflectance that changes with the view imitates a relief, so the two halves of the views test each other:
with a true relief, the components of surface points explain more of the other half, and both find the same height.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from baselines.relief.appearance import refine, unexplained
from baselines.relief.planes import HEIGHTS, REACH, blurred, least, refined, shifted
from bench.btf import BTF, Layout
from bench.codec import Fit
from bench.directions.hemisphere import thin

MOST_VIEWS, MOST_LIGHTS = 32, 32  # the most views and lights that are compared
MEMORY = 256 << 20  # bytes of slices that are kept; larger pictures use fewer lights
TRUNCATION = 0.5  # limit of a difference of log radiance, so that an occluded point does not outweigh the others
LEAST_GAIN = 0.05  # a relief has 0.2 and more; noise and reflectance of planes have less than 0
LEAST_LEFT = 1e-4  # of log radiance: below, a plane leaves only rounding
LEAST_LIKENESS = 0.5  # a relief has 0.8 and more, planes have less than 0


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
    views = torch.from_numpy(btf.layout.views[[int(btf.layout.view[row[0]]) for row in grid]]).float()
    slices = _read(btf, grid, gain, fit)
    halves = [[0, *range(start, len(views), 2)] for start in (1, 2)]  # the most frontal view is in both
    heights = [_swept(slices[half], views[half]) for half in halves]
    gains = []
    for height, half in zip(heights, halves[::-1], strict=True):
        plane, relief = (unexplained(each, slices[half], views[half]) for each in (torch.zeros_like(height), height))
        gains.append((plane - relief) / max(plane, LEAST_LEFT))
    return SweptHeight(_swept(slices, views), min(gains), _likeness(*(height.flatten() for height in heights)))


def _swept(slices: Tensor, views: Tensor) -> Tensor:
    """The height (H, W) at which views (V, 3) of slices (V, L, H, W) agree: a coarse sweep, a fine one, and a third."""
    heights = torch.linspace(-REACH, REACH, HEIGHTS)
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
    pairs = np.full((len(layout.views), len(layout.lights)), -1)
    pairs[layout.view, layout.light] = np.arange(len(layout.view))
    front = int(np.argmax(np.where((pairs >= 0).sum(1) > 1, layout.views[:, 2], -1)))
    lights = np.flatnonzero(pairs[front] >= 0)
    lights = lights[thin(layout.lights[lights], min(MOST_LIGHTS, len(lights)))]
    full = np.flatnonzero((pairs[:, lights] >= 0).all(1))
    full = full[full != front]
    if len(lights) < 2 or len(full) < 2:
        return None
    full = full[thin(layout.views[full], min(MOST_VIEWS - 1, len(full)))]
    grid: np.ndarray = pairs[np.concatenate([[front], full])][:, lights]
    return grid


def _read(btf: BTF, grid: np.ndarray, gain: float, fit: Fit) -> Tensor:
    """Log radiance (V, L, H, W) of pairs (V, L), the mean of the channels."""
    lights = max(2, MEMORY // (len(grid) * btf.shape[0] * btf.shape[1] * 4))
    grid = grid[:, :lights]
    slices = fit.progress(btf.subset(grid.reshape(-1)), "sweeping", grid.size)
    logs = [torch.from_numpy(np.maximum(each, 0)).mul_(gain).log1p_().mean(-1) for each in slices]
    return torch.stack(logs).reshape(*grid.shape, *btf.shape).to(fit.device)


def _costs(slices: Tensor, views: Tensor, heights: Tensor) -> Tensor:
    """The disagreement of the views with the first at each height and surface point: (heights, H, W)."""
    costs = torch.zeros(len(heights), *slices.shape[2:], device=slices.device)
    weights = (views[1:, 2] / views[1:, 2].sum()).tolist()
    for i, z in enumerate(heights.tolist()):
        front = shifted(slices[0], views[0], z)
        for view, each, weight in zip(views[1:], slices[1:], weights, strict=True):
            apart = (shifted(each, view, z) - front).abs_().clamp_max_(TRUNCATION)
            costs[i].add_(apart.mean(0), alpha=weight)
    return blurred(costs)
