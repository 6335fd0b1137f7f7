"""Refines a height: at which height does each surface point look most like the other points of the material?

A sweep that compares views with one another mistakes a highlight, which moves with the view, for parallax. So the
ABRDFs of the surface points at a first height give principal components, and a second sweep looks for the height at
which they explain most of a point's ABRDF. If much of the surface hides behind itself, the first height stays.
"""

import torch
from torch import Tensor

from baselines.relief.geometry import Surface, slope, wrapped
from baselines.relief.planes import HEIGHTS, REACH, blurred, refined, shifted
from bench.material import sample_texture, texel_centres

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
        left = moved.flatten(1) * weight - mean
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
    return apart, mean, weight, torch.linalg.eigh(double @ double.T)[1][:, -COMPONENTS:].to(radiance)


def hidden(height: Tensor, views: Tensor) -> float:
    """The share of surface points, over all views (V, 3), that another point hides by more than a texel."""
    surface, flat, shape = Surface(height), height.reshape(-1, 1), (height.shape[0], height.shape[1])
    count = 0
    for view in views.float():
        along = slope(view[None], shape)
        met = surface.meet(wrapped(_places(height, view)), view.expand(len(flat), 3))[1]
        count += int(((met - flat).abs() * along.norm() * shape[1] > 1).sum())
    return count / (len(views) * len(flat))


def _at_surface(slices: Tensor, view: Tensor, height: Tensor) -> Tensor:
    """The log radiance (L, H · W) of each surface point in slices (L, H, W) of a view (3,), at its visible place."""
    return sample_texture(slices.permute(1, 2, 0), wrapped(_places(height, view)).to(slices)).T


def _places(height: Tensor, view: Tensor) -> Tensor:
    """Where a view (3,) shows the surface points of the texels: uv (H · W, 2), not wrapped."""
    shape = (height.shape[0], height.shape[1])
    return texel_centres(*shape) - height.reshape(-1, 1) * slope(view[None].float(), shape)
