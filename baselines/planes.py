"""Planes over directions for `triple-plane` and `biplane`: half and difference vectors, places, blur.

A *plane* is a square picture of features whose texels stand for directions of the upper hemisphere, by their x and y.
The *half vector* h lies midway between view wo and light wi; the *difference vector* is the light as h sees it.
"""

from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

Difference = Literal["rusinkiewicz", "nearest"]


def half_and_difference(wo: Tensor, wi: Tensor, kind: Difference) -> tuple[Tensor, Tensor]:
    """The half vector h, and the light as h sees it, the difference vector: unit vectors (n, 3), z ≥ 0.

    Directions are unit vectors (n, 3) with z > 0. The difference vector is the light after a turn that takes h to z.
    "rusinkiewicz" turns about z and then about y, as published (1998), which jumps where h is z; "nearest" is the
    shortest turn, which does not.
    """
    h = functional.normalize(wo + wi, dim=1)
    if kind == "nearest":
        # The turn that takes h to z: w − (w · (h + z)) / (1 + h_z) (h + z) + 2 (w · h) z.
        z = torch.cat([torch.zeros_like(h[:, :2]), torch.ones_like(h[:, :1])], 1)
        share_of_sum = (wi * (h + z)).sum(1, keepdim=True) / (1 + h[:, 2:])
        wi_h = (wi * h).sum(1, keepdim=True)
        return h, wi - share_of_sum * (h + z) + 2 * wi_h * z
    # The turn about z by −φ, then about y by −θ, of h = (sin θ cos φ, sin θ sin φ, cos θ). Where h is z, φ is 0.
    sin_theta = torch.linalg.vector_norm(h[:, :2], dim=1, keepdim=True)
    cos_sin_of_0 = torch.cat([torch.ones_like(sin_theta), torch.zeros_like(sin_theta)], 1)
    cos_phi, sin_phi = torch.where(sin_theta > 0, h[:, :2] / sin_theta, cos_sin_of_0).unbind(1)  # (n,) each
    # The light after the first turn; its z stays.
    x = cos_phi * wi[:, 0] + sin_phi * wi[:, 1]
    y = cos_phi * wi[:, 1] - sin_phi * wi[:, 0]
    # The light after the second turn; its y stays, and its z is the cosine between light and half vector.
    turned_x = h[:, 2] * x - sin_theta[:, 0] * wi[:, 2]
    turned_z = (wi * h).sum(1)
    return h, torch.stack([turned_x, y, turned_z], 1)


def places(directions: Tensor, resolution: int) -> Tensor:
    """The uv (n, 2) of unit directions (n, 3) in a plane of `resolution` texels a side, by their x and y.

    −1 is the centre of the first texel and 1 that of the last, so that nothing wraps around.
    """
    # Half a texel is 1 / resolution of the plane from −1 to 1.
    within_centres = directions[:, :2].clamp(-1, 1) * (1 - 1 / resolution)
    return (within_centres + 1) / 2


def blurring(side: int, sigma: float) -> Tensor:
    """The matrix (side, side) that blurs one side of a plane by a Gaussian of σ texels; nothing wraps.

    Row i has the weights of all texels in the blurred texel i; they add up to 1.
    """
    distance = torch.arange(side)[:, None] - torch.arange(side)  # (side, side), in texels
    # A σ of 0 blurs nothing; the least one has the same effect, and does not divide by 0.
    kernel = (-0.5 * (distance / max(sigma, 1e-3)) ** 2).exp()
    return kernel / kernel.sum(1, keepdim=True)


def blurred(planes: Tensor, kernel: Tensor) -> Tensor:
    """Planes (p, side, side, C) blurred along both sides by a matrix (side, side) of `blurring`."""
    # One side after the other, because einsum would first expand all four indices of both kernels.
    rows = torch.einsum("ia,pabc->pibc", kernel, planes)
    return torch.einsum("jb,pibc->pijc", kernel, rows)
