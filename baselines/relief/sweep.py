"""Finds the height of each texel by plane sweep: where do all views show one and the same surface?

At the right height z, the slices of every view, shifted by −z · ω_o.xy / ω_o.z, agree with those of the most frontal
view under the same light (Collins, "A space-sweep approach to true multi-image matching", CVPR 1996). Reflectance that
changes with the view imitates a relief. So halves of the views and of the lights judge each other: a true relief takes
from the cost of those it was not found with, both halves find the same one, and it ends within the heights tried.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF, Layout
from bench.codec import Fit
from bench.hemisphere import thin

HEIGHTS, REACH = 41, 0.1  # heights tried, up to ± that many widths of the picture
MOST_VIEWS, MOST_LIGHTS = 32, 32  # that are compared
MEMORY = 256 << 20  # bytes of slices that are kept: fewer lights, where that is not enough
TRUNCATION = 0.5  # of a difference of log radiance: an occluded point must not outweigh the others
BLUR = 0.7  # texels, σ of a Gaussian over the costs
LEAST_GAIN = 0.008  # share of the cost at z = 0 that a relief must take in every half that it was not found with
LEAST_LIKENESS = 0.4  # correlation of what two halves of the views find
MOST_ENDS = 0.02  # share of the texels whose best height may lie at an end of those tried


@dataclass(frozen=True)
class Found:
    """A height (H, W) and what speaks for it; see the module."""

    height: Tensor
    gain: float  # the least share of the cost at z = 0 that a half of the data takes from the other
    likeness: float  # correlation of the heights that two halves of the views find
    ends: float  # share of texels at an end of the heights tried

    @property
    def stands(self) -> bool:
        """Whether it is a relief, and not what noise or reflectance makes of a plane."""
        return self.gain >= LEAST_GAIN and self.likeness >= LEAST_LIKENESS and self.ends <= MOST_ENDS


def find(btf: BTF, gain: float, fit: Fit) -> Found | None:
    """The relief that the slices of a BTF show best; None where views or lights are too few to tell."""
    grid = _grid(btf.layout)
    if grid is None:
        return None
    views = torch.from_numpy(btf.layout.views[[int(btf.layout.view[row[0]]) for row in grid]])
    slices = _read(btf, grid, gain, fit)
    heights = torch.linspace(-REACH, REACH, HEIGHTS)
    coarse = _least(_costs(slices, views, heights).sum((0, 1)))
    ends = float(((coarse == 0) | (coarse == HEIGHTS - 1)).float().mean())
    low, high = (float(heights[int(i)]) for i in coarse.aminmax())
    step = float(heights[1] - heights[0])
    heights = torch.linspace(low - step, high + step, HEIGHTS)
    costs, flat = _costs(slices, views, heights), _costs(slices, views, torch.zeros(1))
    gains, likeness = [], 0.0
    for by in (0, 1):  # halves of the lights, then of the views
        halves, planes = costs.sum(by), flat.sum(by)
        best = [_least(half) for half in halves]
        gains += [
            1 - float(halves[1 - i].gather(0, best[i]).mean() / planes[1 - i].mean().clamp_min(1e-12)) for i in (0, 1)
        ]
        likeness = _likeness(*(heights[half.cpu()].flatten() for half in best))
    return Found(_refined(costs.sum((0, 1)), heights), min(gains), likeness, ends)


def _likeness(one: Tensor, other: Tensor) -> float:
    """The correlation of two heights (n,); 0 where one is constant."""
    one, other = one - one.mean(), other - other.mean()
    return float((one @ other) / (one.norm() * other.norm()).clamp_min(1e-12))


def _grid(layout: Layout) -> np.ndarray | None:
    """Pairs (V, L) of some views, the most frontal first, each with the same lights; None where there are too few."""
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
    found: np.ndarray = pairs[np.concatenate([[front], full])][:, lights]
    return found


def _read(btf: BTF, grid: np.ndarray, gain: float, fit: Fit) -> Tensor:
    """Log radiance (V, L, H, W) of pairs (V, L), the mean of the channels."""
    lights = max(2, MEMORY // (len(grid) * btf.shape[0] * btf.shape[1] * 4))
    grid = grid[:, :lights]
    slices = fit.progress(grid.reshape(-1).tolist(), "sweeping")
    logs = [torch.from_numpy(np.maximum(btf[pair], 0)).mul_(gain).log1p_().mean(-1) for pair in slices]
    return torch.stack(logs).reshape(*grid.shape, *btf.shape).to(fit.device)


def _costs(slices: Tensor, views: Tensor, heights: Tensor) -> Tensor:
    """How little the views agree at each height and surface point, by halves: (views' 2, lights' 2, heights, H, W)."""
    shape = (slices.shape[2], slices.shape[3])
    costs = torch.zeros(2, 2, len(heights), *shape, device=slices.device)
    weights = (views[1:, 2] / views[1:, 2].sum()).tolist()
    for i, z in enumerate(heights.tolist()):
        front = shifted(slices[0], views[0], z)
        for number, (view, each, weight) in enumerate(zip(views[1:], slices[1:], weights, strict=True)):
            apart = (shifted(each, view, z) - front).abs_().clamp_max_(TRUNCATION)
            for half in (0, 1):
                costs[number % 2, half, i].add_(apart[half::2].mean(0), alpha=weight)
    return _blurred(costs.flatten(0, 2)).unflatten(0, (2, 2, -1))


def shifted(slices: Tensor, view: Tensor, z: float) -> Tensor:
    """What slices (L, H, W) of a view (3,) show of each surface point, if all of them have the height z."""
    x, y, up = view.tolist()
    cols, rows = -z * x / up * slices.shape[2], z * y / up * slices.shape[2]
    return _moved(_moved(slices, rows, 1), cols, 2)


def _moved(slices: Tensor, by: float, axis: int) -> Tensor:
    """Periodic slices read at place + by along an axis, linear."""
    whole = int(np.floor(by))
    near = slices.roll(-whole, axis)
    return torch.lerp(near, near.roll(-1, axis), by - whole) if by != whole else near


def _blurred(costs: Tensor) -> Tensor:
    """Costs (Z, H, W) convolved with a periodic Gaussian of `BLUR` texels."""
    reach = torch.arange(-2, 3)
    kernel = (-0.5 * (reach / BLUR).square()).exp()
    for axis in (1, 2):
        costs = torch.stack([k * costs.roll(int(r), axis) for k, r in zip(kernel / kernel.sum(), reach, strict=True)])
        costs = costs.sum(0)
    return costs


def _least(costs: Tensor) -> Tensor:
    return costs.argmin(0, keepdim=True)


def _refined(costs: Tensor, heights: Tensor) -> Tensor:
    """The height (H, W) of least cost, by a parabola through it and its two neighbours."""
    best = _least(costs).clamp(1, HEIGHTS - 2)
    below, at, above = (costs.gather(0, best + step)[0] for step in (-1, 0, 1))
    bend = (below - 2 * at + above).clamp_min(1e-9)
    place = best[0] + (0.5 * (below - above) / bend).clamp(-0.5, 0.5)
    return (heights[0] + place * (heights[1] - heights[0])).cpu()
