"""Network inputs of two directions: in the tangent plane, with their half vector, or in learned shading frames.

Zeltner et al., "Real-time neural appearance models", ACM Trans. Graph. 43(3), 2024: each frame is linear in a texel's
latents and has a normal and a tangent, each normalised but not made orthogonal to the other, and their cross product.
"""

from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.material import saturated

Directions = Literal["xy", "xyzh"]

COUNTS = {"xy": 4, "xyzh": 9}  # count of inputs for both directions together
CANONICAL = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0)  # normal and tangent of the surface itself
SPREAD = 0.1  # standard deviation of the first weights


def direction_inputs(wo: Tensor, wi: Tensor, kind: Directions) -> tuple[Tensor, Tensor]:
    """Network inputs of unit directions wo, wi (n, 3): those of the view, then those of the light and the half vector.

    `xy`: x and y of each. `xyzh`: x, y and z of each, and of the half vector, around which highlights lie.
    """
    if kind == "xy":
        return wo[:, :2], wi[:, :2]
    return wo, torch.cat([wi, functional.normalize(wo + wi)], 1)


class Frames(nn.Linear):
    """`count` frames from latents (n, latents): 6 · count outputs, a normal and a tangent of each frame.

    The surface's own axes are added to the outputs, so that frames start near these.
    """

    def __init__(self, latents: int, count: int, generator: torch.Generator | None = None):
        """Draw small weights, so that all frames start near the surface's own."""
        super().__init__(latents, 6 * count, bias=False)
        self.count = count
        self.canonical = nn.Buffer(torch.tensor(CANONICAL * count), persistent=False)
        with torch.no_grad():
            self.weight.normal_(0, SPREAD, generator=generator)

    def turned(self, latents: Tensor, directions: Tensor) -> Tensor:
        """Directions (n, D, 3) on the axes tangent, bitangent, normal of each frame in turn: (n, D · count · 3)."""
        # Queries last: a product of small matrices for each query takes three times as long.
        rows = saturated(self(latents)).to(directions.dtype).mT.contiguous()  # (6 · count, n)
        vectors = rows.unflatten(0, (self.count, 2, 3))  # (count, 2, 3, n): normal and tangent of each frame
        length = vectors.square().sum(2, keepdim=True).clamp_min(1e-24).sqrt()  # (count, 2, 1, n)
        normal, tangent = (vectors / length).unbind(1)  # (count, 3, n) each
        bitangent = torch.linalg.cross(normal, tangent, dim=1)
        axes = torch.stack([tangent, bitangent, normal], 1).flatten(0, 1)  # (count · 3, 3, n): each axis its x, y, z
        turned = (directions.permute(1, 2, 0).contiguous()[:, None] * axes).sum(2)  # (D, count · 3, n)
        return turned.flatten(0, 1).mT

    def forward(self, latents: Tensor) -> Tensor:
        """Normal and tangent of each frame (n, 6 · count), of no particular length."""
        axes: Tensor = super().forward(latents)
        return axes + self.canonical

    def flops(self, directions: int) -> int:
        """Operations of a sample that turns some directions, a fused multiply-add counted as two."""
        two_lengths = 2 * 8  # of normal and tangent: square, add, root, divide
        cross_product = 9
        products = directions * 3 * 5  # of each direction with three axes
        return 2 * self.in_features * self.out_features + self.count * (two_lengths + cross_product + products)
