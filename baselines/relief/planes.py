"""Slices and costs over a range of heights, shifted to the place where each height shows a surface point."""

import math

import torch
from torch import Tensor

HEIGHTS, REACH = 41, 0.1  # heights tried, up to ± that many widths of the picture
BLUR = 0.7  # texels, σ of a Gaussian over the costs


def shifted(slices: Tensor, view: Tensor, z: float) -> Tensor:
    """The values of surface points in slices (L, H, W) of a view (3,), if all points have the height z."""
    x, y, up = view.tolist()
    cols, rows = -z * x / up * slices.shape[2], z * y / up * slices.shape[2]
    return _moved(_moved(slices, rows, 1), cols, 2)


def _moved(slices: Tensor, by: float, axis: int) -> Tensor:
    """Periodic slices read at place + by along an axis, linear."""
    whole = math.floor(by)
    near = slices.roll(-whole, axis)
    return torch.lerp(near, near.roll(-1, axis), by - whole) if by != whole else near


def blurred(costs: Tensor) -> Tensor:
    """Costs (Z, H, W) convolved with a periodic Gaussian of `BLUR` texels."""
    reach = torch.arange(-2, 3)
    kernel = (-0.5 * (reach / BLUR).square()).exp()
    for axis in (1, 2):
        costs = torch.stack([k * costs.roll(int(r), axis) for k, r in zip(kernel / kernel.sum(), reach, strict=True)])
        costs = costs.sum(0)
    return costs


def least(costs: Tensor) -> Tensor:
    """Index (1, H, W) of the cheapest height at each texel, from costs (Z, H, W)."""
    return costs.argmin(0, keepdim=True)


def refined(costs: Tensor, heights: Tensor) -> Tensor:
    """The height (H, W) of least cost, by a parabola through it and its two neighbours."""
    best = least(costs).clamp(1, len(heights) - 2)
    below, at, above = (costs.gather(0, best + step)[0] for step in (-1, 0, 1))
    bend = (below - 2 * at + above).clamp_min(1e-9)
    place = best[0] + (0.5 * (below - above) / bend).clamp(-0.5, 0.5)
    return (heights[0] + place * (heights[1] - heights[0])).cpu()
