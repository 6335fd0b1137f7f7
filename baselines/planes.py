"""Planes over directions for `triple-plane` and `biplane`: half and difference vectors, places, blur."""

from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

Difference = Literal["rusinkiewicz", "nearest"]


def half_and_difference(wo: Tensor, wi: Tensor, kind: Difference) -> tuple[Tensor, Tensor]:
    """The half vector h, and the light as h sees it, the difference vector: unit vectors (n, 3), z ≥ 0.

    The difference vector is the light after a turn that takes h to z. "rusinkiewicz" turns about z and then about y, as
    published (1998), which jumps where h is z; "nearest" is the shortest turn, which does not.
    """
    h = functional.normalize(wo + wi, dim=1)
    if kind == "nearest":
        # The turn that takes h to z: w − (w · (h + z)) / (1 + h_z) (h + z) + 2 (w · h) z.
        z = torch.cat([torch.zeros_like(h[:, :2]), torch.ones_like(h[:, :1])], 1)
        along = (wi * (h + z)).sum(1, keepdim=True) / (1 + h[:, 2:])
        return h, wi - along * (h + z) + 2 * (wi * h).sum(1, keepdim=True) * z
    # The turn about z by −φ, then about y by −θ, of h = (sin θ cos φ, sin θ sin φ, cos θ). Where h is z, φ is 0.
    sine = torch.linalg.vector_norm(h[:, :2], dim=1, keepdim=True)
    zenith = torch.cat([torch.ones_like(sine), torch.zeros_like(sine)], 1)
    cos_phi, sin_phi = torch.where(sine > 0, h[:, :2] / sine, zenith).unbind(1)  # (n,) each
    x = cos_phi * wi[:, 0] + sin_phi * wi[:, 1]
    y = cos_phi * wi[:, 1] - sin_phi * wi[:, 0]
    return h, torch.stack([h[:, 2] * x - sine[:, 0] * wi[:, 2], y, (wi * h).sum(1)], 1)


def places(directions: Tensor, resolution: int) -> Tensor:
    """The uv (n, 2) of unit directions (n, 3) in a plane of `resolution` texels a side, by their x and y.

    −1 is the centre of the first texel and 1 that of the last, so that nothing wraps around.
    """
    return (directions[:, :2].clamp(-1, 1) * (1 - 1 / resolution) + 1) / 2


def blurring(side: int, sigma: float) -> Tensor:
    """The kernel (side, side) that blurs one side of a plane by a Gaussian of σ texels; nothing wraps."""
    apart = torch.arange(side)[:, None] - torch.arange(side)  # (side, side), in texels
    kernel = (-0.5 * (apart / max(sigma, 1e-3)) ** 2).exp()
    return kernel / kernel.sum(1, keepdim=True)


def blurred(planes: Tensor, kernel: Tensor) -> Tensor:
    """Planes (p, side, side, C) blurred along both sides by a kernel (side, side) of `blurring`."""
    # One side after the other, because einsum would first expand all four indices of both kernels.
    rows = torch.einsum("ia,pabc->pibc", kernel, planes)
    return torch.einsum("jb,pibc->pijc", kernel, rows)
